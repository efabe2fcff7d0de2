"""The user's simulator command: its placeholders, and what they stand for in a round."""

from __future__ import annotations

import shlex
import string
from dataclasses import dataclass
from pathlib import Path

from mavcal.service.closing.errors import WrongCommand

PLACEHOLDERS = {
    "params": "the parameter file",
    "frame": "the frame file",
    "log": "where the log belongs",
    "port": "a free port",
    "speedup": "the speed",
    "here": "the folder in which mavcal was started",
}
"""Files are named relative to the folder of the round, in which the command runs: ArduPilot's simulator takes no
absolute frame file."""


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
            names = [name for part in self._parts() for _, name, _, _ in string.Formatter().parse(part)]
        except ValueError as error:
            raise WrongCommand(
                f"the simulator's command cannot be read: {error}. Check its quotes and braces."
            ) from error
        if not self._parts():
            raise WrongCommand("the simulator's command is empty; example: arducopter --model x:{frame} ...")
        unknown = sorted({name for name in names if name is not None and name not in PLACEHOLDERS})
        if unknown:
            known = ", ".join(f"{{{name}}} ({what})" for name, what in PLACEHOLDERS.items())
            raise WrongCommand(
                f"the simulator's command has {{{unknown[0]}}}; known are {known}. Write {{{{ for a brace."
            )

    def has(self, name: str) -> bool:
        """Whether the placeholder is used."""
        return any(found == name for part in self._parts() for _, found, _, _ in string.Formatter().parse(part))

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

    def _parts(self) -> list[str]:
        return shlex.split(self.text)


PARAMETERS, FRAME, LOG = "sim.parm", "frame.json", "log.bin"
"""Names of a round's files."""
