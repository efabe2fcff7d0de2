"""Settings of the simulator: parameters and keys of its frame file, given first, then patched by each round."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mavcal.calib.gap.schema import EffectEstimate
from mavcal.service.closing.errors import WrongCommand

FRAME = "frame_json"
"""Key of a patch under which the frame file's keys stand."""
_ELSEWHERE = ("sdf",)
"""Tables of a patch for simulators that take neither parameters nor a frame file."""
LOGGING: Mapping[str, float] = {
    "LOG_BITMASK": 407189, "LOG_DISARMED": 1, "LOG_FILE_DSRMROT": 0, "LOG_FILE_BUFSIZE": 8000,
}  # fmt: skip
"""ArduPilot's logging of everything that a diagnosis needs: full rate, and the rest before and after the flight
(AIRFRAME 3.1, and the compass). The buffer has 8 MB: 200 kB lose samples at twice real time. These come before all
other parameters, so that given values override them."""


@dataclass(frozen=True)
class SimSettings:
    """Parameters by name, and keys of the frame file, as the simulator of one round has them."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    frame: Mapping[str, Any] = field(default_factory=dict)

    def patched(self, effects: Iterable[EffectEstimate]) -> SimSettings:
        """These settings with every effect's `sim_patch`: absolute values, of which the last one of a name counts."""
        parameters, frame = dict(self.parameters), dict(self.frame)
        for effect in effects:
            for name, value in effect.sim_patch.items():
                if name == FRAME:
                    frame.update(value)
                elif name not in _ELSEWHERE:
                    parameters[name] = float(value)
        return SimSettings(parameters, frame)

    def changed_from(self, other: SimSettings) -> dict[str, tuple[Any, Any]]:
        """The changed settings by name: value in `other` (None: not set) and value here."""
        before = {**other.parameters, **other.frame}
        now = {**self.parameters, **self.frame}
        return {name: (before.get(name), value) for name, value in now.items() if before.get(name) != value}

    def as_json(self) -> dict[str, Any]:
        """Both, as data."""
        return {"parameters": dict(self.parameters), "frame": dict(self.frame)}

    def write(self, parameters: Path, frame: Path) -> None:
        """Both files, as ArduPilot's simulator reads them."""
        lines = [f"{name} {value:.9g}" for name, value in {**LOGGING, **self.parameters}.items()]
        parameters.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        frame.write_text(json.dumps(dict(self.frame), indent=1) + "\n", encoding="utf-8")


def read_settings(parameters: Path | None, frame: Mapping[str, Any] | None) -> SimSettings:
    """The settings of the first round; None: nothing is set.

    Raises
    ------
    WrongCommand
        If the file has a line that is no parameter, or cannot be read.
    """
    return SimSettings({} if parameters is None else _parameters(parameters), frame or {})


def _parameters(file: Path) -> dict[str, float]:
    found: dict[str, float] = {}
    for number, line in enumerate(_text(file).splitlines(), start=1):
        parts = line.partition("#")[0].replace(",", " ").split()
        if not parts:
            continue
        try:
            found[parts[0]] = float(parts[1])
        except (IndexError, ValueError) as error:
            raise WrongCommand(f"{file.name}, line {number}: {line.strip()!r} is not NAME VALUE") from error
    return found


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise WrongCommand(f"{file} cannot be read: {error.strerror}") from error
