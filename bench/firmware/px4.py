"""PX4's posix build with sensors of our own, and an extra MAVLink link on ports of our own.

Start-up as in PX4's ``px4-rc.mavlinksim`` (FLIGHT_CONTROLLERS 7.2); ``temperature_compensation`` is started as the
start script of real boards does (section 10 there).
"""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.firmware.process import FirmwareProcess, SecondConnection
from bench.firmware.px4_source import HOME
from bench.firmware.truth import FACES, GAUSS, VehicleTruth

HAND_DPS: Final = 90.0
MIDDLE_C: Final = 25.0
"""At which the sensors are until they drift."""
RESTARTED_S: Final = 4.0
"""A link that is silent for so long is not there: its heartbeats come every second."""
ACCEL_NOISE, GYRO_NOISE, MAG_NOISE_GAUSS = 0.02, 0.002, 0.001
REAL32, INT32 = 9, 6
PREFLIGHT_CALIBRATION, FIXED_MAG_CAL_YAW = 241, 42006


class Px4:
    """One PX4 whose sensors, attitude and temperature are ours; moved by requests of :class:`simvehicle.Operator`."""

    autopilot: Final = "px4"

    def __init__(self, build: Path, folder: Path, truth: VehicleTruth, instance: int) -> None:
        self.truth, self._build, self._folder, self._instance = truth, build, folder, instance
        (folder / "truth.json").write_text(json.dumps(sensors(truth)))
        self._control_port = 4460 + instance
        source = [sys.executable, "-m", "bench.firmware.px4_source", str(4560 + instance), str(self._control_port)]
        home = folder / "source"
        home.mkdir()
        self._source = FirmwareProcess([*source, str(folder / "truth.json")], home, {"PYTHONPATH": os.getcwd()})
        command = [str(build / "bin" / "px4"), "-d", "-i", str(instance), "-w", str(folder), str(build / "etc")]
        path = f"{build / 'bin'}{os.pathsep}{os.environ['PATH']}"
        self._process = FirmwareProcess(command, folder, {"PX4_SIM_MODEL": "none_iris", "PATH": path})
        mavcal, beside = 21000 + instance, 21100 + instance
        self._links = ((22000 + instance, mavcal), (22100 + instance, beside))
        self.url = f"udpin:127.0.0.1:{mavcal}"
        self.beside = SecondConnection(f"udpin:127.0.0.1:{beside}", system=instance + 1)
        self._rng = np.random.default_rng([40, truth.seed])
        self._over = threading.Event()
        self._keeper: threading.Thread | None = None

    def start(self) -> None:
        """Start the source, the firmware, and both links; connect beside mavcal."""
        if not self._source.runs:
            self._source.start()
        self._process.start()
        self.beside.wait(self._answers, 60.0, f"PX4 does not start: {self._process.last_lines()}")
        self._start_links()
        self.beside.open()
        self._over.clear()
        self._keeper = threading.Thread(target=self._keep_links, name="px4-links", daemon=True)
        self._keeper.start()

    def _start_links(self) -> None:
        self._shell("temperature_compensation", "start")
        for local, remote in self._links:
            self._shell(
                "mavlink", "start", "-x", "-u", str(local), "-o", str(remote), "-r", "4000000", "-t", "127.0.0.1"
            )

    def _keep_links(self) -> None:
        """Start the links again after a restart that mavcal has asked for: PX4 starts again in the same process."""
        while not self._over.wait(1.0):
            if self.beside.silent_s > RESTARTED_S:
                with suppress(subprocess.TimeoutExpired):
                    if self._answers():
                        self._start_links()

    def _end(self) -> None:
        self._over.set()
        if self._keeper is not None:
            self._keeper.join()
        self.beside.close()
        self._process.stop()

    def drift(self) -> None:
        """From now on the sensors drift with temperature, about that at which they were until now."""
        for kind in ("accel", "gyro"):
            for instance, unit in enumerate(self.truth.units):
                drift = unit.accel_drift if kind == "accel" else unit.gyro_drift
                change = {"drift": drift.tolist()}
                self._ask({"do": "set", "sensor": kind, "instance": instance, "change": change})

    def quick_calibrated(self) -> None:
        """PX4's own quick calibrations: they store the device ids, which no stream tells. What they find is wrong."""
        for command, values, name in (
            (PREFLIGHT_CALIBRATION, (0, 0, 0, 0, 4), "CAL_ACC0_ID"),
            (FIXED_MAG_CAL_YAW, (0, 0, HOME[0], HOME[1]), "CAL_MAG0_ID"),
        ):
            self.beside.wait(partial(self._id_stored, command, values, name), 60.0, f"{name} stays 0")

    def _id_stored(self, command: int, values: Sequence[float], name: str) -> bool:
        if self.read(name):
            return True
        self.beside.command(command, *values)
        return bool(self.read(name))

    def stop(self) -> None:
        """End the firmware and the source."""
        self._end()
        self._source.stop()

    def restart(self) -> None:
        """Power off and on; what the firmware has saved stays, and so does the attitude."""
        self._end()
        self.start()

    def read(self, name: str) -> float | None:
        """The value that the vehicle holds now."""
        found: Any = self.beside.read_parameter(name)
        if found is None:
            return None
        if found.param_type == INT32:
            return int(struct.unpack("<i", struct.pack("<f", found.param_value))[0])
        return float(found.param_value)

    def set(self, name: str, value: float) -> None:
        """Set a parameter from beside; whole numbers as INT32."""
        kind = INT32 if isinstance(value, int) else REAL32
        wire = struct.unpack("<f", struct.pack("<i", value))[0] if isinstance(value, int) else value
        system = self._instance + 1
        self.beside.send(lambda mav: mav.param_set_send(system, 1, name.encode(), wire, kind))

    def call(self, do: str, **options: Any) -> dict[str, Any]:
        """One request of an Operator, or ``set`` for a fault of a sensor."""
        asked: dict[str, Any] = {"do": do}
        if do == "hold":
            asked |= {"pose": self._pose(options["pose"]), "dps": HAND_DPS}
        elif do == "tumble":
            asked |= {"dps": options["rate_dps"]}
        elif do == "temperature":
            asked |= {"celsius": options["value"]}
        else:
            asked |= options
        state = self._ask(asked)
        return {"temperatures": [state["celsius"]], "quaternion": state["q"]}

    def _pose(self, pose: str | Sequence[float]) -> list[float]:
        angles = np.array(FACES[pose] if isinstance(pose, str) else pose, dtype=float)
        if isinstance(pose, str) and pose != "level":
            angles[:2] += self._rng.uniform(-4.0, 4.0, 2)
        return [float(a) for a in angles]

    def _ask(self, asked: dict[str, Any]) -> dict[str, Any]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            control.settimeout(5.0)
            control.sendto(json.dumps(asked).encode(), ("127.0.0.1", self._control_port))
            answer: dict[str, Any] = json.loads(control.recvfrom(65535)[0])
        return answer

    def _answers(self) -> bool:
        return self._shell("ver", "git") == 0 and self._shell("mavlink", "status") == 0

    def _shell(self, module: str, *arguments: str) -> int:
        """One command of PX4's own shell, by the client that its build makes of each module."""
        run = subprocess.run(
            [str(self._build / "bin" / f"px4-{module}"), "--instance", str(self._instance), *arguments],
            cwd=self._folder,
            capture_output=True,
            timeout=30.0,
            check=False,
        )
        return run.returncode


def sensors(truth: VehicleTruth) -> dict[str, Any]:
    """The truth as the source takes it: measured = matrix @ true + offset, Gauss for compasses."""
    return {
        "seed": truth.seed,
        "celsius": MIDDLE_C,
        "middle_celsius": MIDDLE_C,
        "accel": [_sensor(np.diag(u.accel_scale), u.accel_offset, ACCEL_NOISE) for u in truth.units],
        "gyro": [_sensor(np.eye(3), u.gyro_offset, GYRO_NOISE) for u in truth.units],
        "mag": [_sensor(np.linalg.inv(c.matrix), -c.added / GAUSS, MAG_NOISE_GAUSS) for c in truth.compasses],
    }


def _sensor(matrix: Any, offset: Any, noise: float) -> dict[str, Any]:
    return {"matrix": matrix.tolist(), "offset": offset.tolist(), "noise": noise, "drift": []}
