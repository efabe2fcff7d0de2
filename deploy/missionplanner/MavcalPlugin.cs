// Mission Planner: opens the panel of mavcal from the right-click menu of the flight data map.
// Copy this file into the folder "plugins" of Mission Planner, which compiles it at its next start.
// The address is that of the service: on this computer, or of the companion computer on the vehicle.

using System;
using System.Diagnostics;
using System.Windows.Forms;
using MissionPlanner.Plugin;

namespace Mavcal
{
    public class MavcalPlugin : Plugin
    {
        private const string Address = "http://127.0.0.1:8765/";

        public override string Name => "mavcal";

        public override string Version => "0.1";

        public override string Author => "mavcal";

        public override bool Init()
        {
            return true;
        }

        public override bool Loaded()
        {
            var item = new ToolStripMenuItem("Calibrate sensors with mavcal");
            item.Click += (sender, arguments) => Open();
            Host.FDMenuMap.Items.Add(item);
            return true;
        }

        public override bool Exit()
        {
            return true;
        }

        private static void Open()
        {
            try
            {
                Process.Start(new ProcessStartInfo(Address) { UseShellExecute = true });
            }
            catch (Exception error)
            {
                MessageBox.Show($"The panel at {Address} cannot be opened: {error.Message}", "mavcal");
            }
        }
    }
}
