"""What goes wrong with a simulator that is started, flown and ended. None of it comes over HTTP."""

# ruff: noqa: N818 - a name says what happened; "Error" behind each of them would say it again

from __future__ import annotations

from typing import ClassVar


class ClosingError(Exception):
    """The loop between the flight and the simulator could not be closed."""

    code: ClassVar[str] = "closing"


class WrongCommand(ClosingError):
    """The simulator's command has a placeholder that does not exist, or lacks one that is needed."""

    code = "simulator-command"


class OtherClosing(ClosingError):
    """The work folder belongs to another flight or another simulator. Choose another one with --work."""

    code = "other-closing"


class WorkFolderUnusable(ClosingError):
    """The folder of the rounds cannot be written. Choose another one with --work."""

    code = "work-folder"


class NoMission(ClosingError):
    """The log holds no mission that a simulator can fly. Fly the standard one with --mission standard."""

    code = "no-mission"


class SimulatorError(ClosingError):
    """The simulator could not be flown; :meth:`with_output` adds what it said last."""

    code = "simulator"

    def with_output(self, lines: str) -> SimulatorError:
        """The same with the simulator's last lines."""
        said = f"\nThe simulator's last lines:\n{lines}" if lines else "\nThe simulator wrote nothing."
        return type(self)(f"{self}{said}")


class SimulatorMissing(SimulatorError):
    """The simulator's command could not be started."""

    code = "simulator-missing"


class SimulatorEnded(SimulatorError):
    """The simulator ended by itself."""

    code = "simulator-ended"


class SimulatorSilent(SimulatorError):
    """The simulator says nothing over MAVLink, or nothing more."""

    code = "simulator-silent"


class NoSimulator(SimulatorError):
    """The vehicle that answers does not show that it is a simulator. Nothing else is ever flown."""

    code = "no-simulator"


class OtherVehicle(SimulatorError):
    """More than one vehicle speaks at the simulator's address."""

    code = "other-vehicle"


class SimulatorUnarmed(SimulatorError):
    """The simulated vehicle refuses to arm."""

    code = "simulator-unarmed"


class MissionLeft(SimulatorError):
    """The simulated vehicle left the mission."""

    code = "mission-left"


class MissionRefused(SimulatorError):
    """The simulated vehicle does not take the mission."""

    code = "mission-refused"


class LogUnusable(SimulatorError):
    """The simulator left no log that can be read."""

    code = "simulator-log"
