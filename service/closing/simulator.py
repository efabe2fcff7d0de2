"""The user's simulator: its command with placeholders, and the process group that runs it.

It is started in the folder of its round, watched, and ended with every process that it started.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import socket
import string
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from mavcal.service.closing.errors import SimulatorEnded, SimulatorMissing, WrongCommand
from mavcal.service.lifetime import ending_with_us

PARAMETERS, FRAME, LOG = "sim.parm", "frame.json", "log.bin"
"""Names of a round's files."""
PLACEHOLDERS = {
    "params": "the parameter file",
    "frame": "the frame file",
    "log": "where the log belongs",
    "port": "a free port",
    "speedup": "the speed",
    "here": "the folder in which mavcal was started",
}
"""Placeholders of the command. Files are relative to the folder of the round, where the command runs: ArduPilot's
simulator takes no absolute frame file."""
OUTPUT = "simulator.txt"
"""File in the folder of the round with what the simulator wrote."""
LAST_LINES, LAST_BYTES = 12, 4000
GRACE_S = 5.0
"""From SIGTERM to SIGKILL: a simulator closes its log meanwhile. Chosen, not measured."""
_LOOK_S = 0.05


@dataclass(frozen=True)
class SimulatorCommand:
    """A command line with placeholders in braces.

    Raises
    ------
    WrongCommand
        If it cannot be split, is empty, or has a placeholder that does not exist.
    """

    text: str

    def __post_init__(self) -> None:
        try:
            names = self._names()
        except ValueError as error:
            raise WrongCommand(
                f"the simulator's command cannot be read: {error}. Check its quotes and braces."
            ) from error
        if not self._parts():
            raise WrongCommand("the simulator's command is empty; example: arducopter --model x:{frame} ...")
        unknown = sorted(names - PLACEHOLDERS.keys())
        if unknown:
            known = ", ".join(f"{{{name}}} ({what})" for name, what in PLACEHOLDERS.items())
            raise WrongCommand(
                f"the simulator's command has {{{unknown[0]}}}; known are {known}. Write {{{{ for a brace."
            )

    def has(self, name: str) -> bool:
        """Whether the placeholder is used."""
        return name in self._names()

    def arguments(self, *, port: int, speedup: float, here: Path) -> list[str]:
        """The command of a round; its files lie in the folder in which it runs."""
        values = {
            "params": PARAMETERS, "frame": FRAME, "log": LOG, "port": str(port), "speedup": f"{speedup:g}",
            "here": str(here),
        }  # fmt: skip
        parts = [part.format_map(values) for part in self._parts()]
        program = here / parts[0]
        if "/" in parts[0] and program.is_file():  # the command runs elsewhere, and means the one from here
            parts[0] = str(program.absolute())
        return parts

    def _names(self) -> set[str]:
        found = (name for part in self._parts() for _, name, _, _ in string.Formatter().parse(part))
        return {name for name in found if name is not None}

    def _parts(self) -> list[str]:
        return shlex.split(self.text)


class Simulator:
    """A running simulator; a context manager that leaves none of its processes behind.

    Raises
    ------
    SimulatorMissing
        If the command cannot be started.
    """

    def __init__(self, arguments: Sequence[str], folder: Path) -> None:
        self._name, self._output = arguments[0], folder / OUTPUT
        self._stopped = False
        with self._output.open("wb") as output:
            try:
                self._process = subprocess.Popen(  # noqa: S603 - the user's own command is what was asked for
                    list(arguments),
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    env=ending_with_us(),
                    start_new_session=True,
                )
            except OSError as error:
                raise SimulatorMissing(
                    f"{self._name} cannot be started: {error.strerror}. It runs in {folder}: give its full path, and "
                    "name other files by {here}/FILE"
                ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def check(self) -> None:
        """Raise SimulatorEnded if it has ended by itself."""
        status = self._process.poll()
        if status is not None:
            how = f"by signal {-status}" if status < 0 else f"with exit code {status}"
            raise SimulatorEnded(f"{self._name} ended {how} before its flight was over. Run the command by hand.")

    def last_lines(self) -> str:
        """The last lines of its output."""
        try:
            with self._output.open("rb") as file:
                file.seek(max(self._output.stat().st_size - LAST_BYTES, 0))
                text = file.read().decode(errors="replace")
        except OSError:
            return ""
        lines = [line.rstrip() for line in text.splitlines() if line.strip()]
        return "\n".join(f"  {line}" for line in lines[-LAST_LINES:])

    def stop(self) -> None:
        """End the process group: SIGTERM, a grace period, SIGKILL; harmless if repeated."""
        if self._stopped:
            return
        group = self._process.pid  # a session's leader gives its group its number
        self._signal(group, signal.SIGTERM)
        end = time.monotonic() + GRACE_S
        try:
            while _lives(group) and time.monotonic() < end:
                self._process.poll()  # a zombie would count as living
                time.sleep(_LOOK_S)
        finally:  # whoever presses Ctrl-C again does not want to wait
            self._signal(group, signal.SIGKILL)
            self._process.wait()
        self._stopped = True

    @staticmethod
    def _signal(group: int, number: int) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(group, number)


def _lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except (ProcessLookupError, PermissionError):
        return False
    return True


def free_port() -> int:
    """A TCP port of loopback that nobody listens on now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
