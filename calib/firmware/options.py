"""Options of a plan that the operator sets: one table for command line, REST API and advice.

Values come as plain data (``{"keep_gyro_at_boot": true, "only": ["gyro0", "accel0"]}``) and stay so in the store;
:func:`compose_options` turns them into what ``compose`` takes. Sensors are named as in a plan's fingerprint: ``gyro0``
is the first gyro.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.recording import Sensor

Key = tuple[Sensor, int]

_KEY: Final = re.compile(rf"({'|'.join(CALIBRATED)})([0-9])")


@dataclass(frozen=True)
class ComposeOptions:
    """Decisions of the operator on a plan."""

    keep_gyro_at_boot: bool = False
    """ArduPilot: write INS_GYR_CAL = 0, so that the next boot does not estimate the gyro offsets again."""
    mark_calibrated: bool = True
    """ArduPilot: send code 76 where every used instance is calibrated."""
    adjust_level: bool = True
    """Carry the old level trim over to the new accelerometer calibration."""
    only: tuple[Key, ...] = ()
    """The sensors to plan for; empty: every one that was fitted."""
    confirm_mounting: bool = False
    """The operator has looked: a compass really is mounted otherwise than the vehicle is told."""
    mountings: Mapping[Key, int] = field(default_factory=lambda: MappingProxyType({}))
    """The firmware's number of the rotation by which a compass is mounted, as the operator chose it."""
    confirm_other_unit: bool = False
    """The operator knows that a recording without a board id is of this vehicle."""
    device_ids: Mapping[Key, int] = field(default_factory=lambda: MappingProxyType({}))
    """PX4: device id of a streamed instance where the vehicle's parameters do not say it."""
    accel_temperature: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({}))
    """PX4: temperature (degC) at which CAL_ACC of an instance was taken; PX4 does not store it."""
    without_row: frozenset[Key] = frozenset()
    """PX4: sensors whose device id is in no row, as the vehicle itself says."""
    unproved_origin: str = ""
    """Why nothing shows that the fits are of this vehicle; empty: something does, or they are its own."""


def key_text(sensor: Sensor, instance: int) -> str:
    """The name of a sensor in options and fingerprints.

    >>> key_text(Sensor.GYRO, 0)
    'gyro0'
    """
    return f"{sensor}{instance}"


def parse_key(text: str) -> Key:
    """The sensor of that name. Raises InvalidInputError."""
    match = _KEY.fullmatch(text.strip())
    if match is None:
        raise InvalidInputError(
            f"{text!r} names no sensor: write {', '.join(f'{s}0' for s in CALIBRATED)} for the first of a kind"
        )
    return Sensor(match[1]), int(match[2])


def unknown_keys(only: Iterable[Key], there: Iterable[Key]) -> str:
    """A sentence that names the sensors of `only` that are not among those `there`; empty: all are."""
    known = sorted(key_text(*key) for key in set(there))
    missing = [key_text(*key) for key in only if key_text(*key) not in known]
    if not missing:
        return ""
    return f"there is no {', '.join(missing)} to plan for; there are: {', '.join(known) or 'none'}"


def how(name: str) -> str:
    """How to give a plan option, on the command line and in a request; every advice is made with it.

    >>> how("keep_gyro_at_boot")
    'the plan option keep_gyro_at_boot (--keep-gyro-at-boot)'
    """
    return f"the plan option {name} (--{PLAN_OPTIONS[name].flag})"


def to_confirm(name: str) -> str:
    """The end of a blocker that a confirmation removes: how the operator confirms it."""
    return f"Confirm it with {how(name)}"


def confirmations(blockers: Iterable[str]) -> tuple[str, ...]:
    """The confirmations that remove all of `blockers`; empty if there are none, or if one stays whatever is confirmed.

    >>> confirmations([f"A log without a board id. {to_confirm('confirm_other_unit')}"])
    ('confirm_other_unit',)
    >>> confirmations(["the offset is too large"])
    ()
    """
    found: dict[str, None] = {}
    for text in blockers:
        name = next((n for n in CONFIRMATIONS if text.endswith(to_confirm(n))), None)
        if name is None:
            return ()
        found[name] = None
    return tuple(found)


@dataclass(frozen=True)
class PlanOption:
    """One decision about a plan."""

    name: str
    read: Callable[[str, Any], Any]
    help: str
    live: bool = True
    """Whether a job that listens to the vehicle can have it; others are of jobs of a recording."""

    @property
    def flag(self) -> str:
        """Its name on the command line, without the dashes."""
        return self.name.replace("_", "-")


def _switch(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InvalidInputError(f"option {name} of a plan is a switch: give true or false, not {value!r}")
    return value


def _sensors(name: str, value: Any) -> tuple[Key, ...]:
    if isinstance(value, str) or not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
        raise InvalidInputError(f"option {name} of a plan is a list of sensors such as gyro0, not {value!r}")
    return tuple(dict.fromkeys(parse_key(text) for text in value))


def _by_sensor(name: str, value: Any, what: str) -> dict[Key, float]:
    fine = isinstance(value, Mapping) and all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in value.values()
    )
    if not fine:
        raise InvalidInputError(f"option {name} of a plan gives {what} by sensor, as {{'accel0': 1}}, not {value!r}")
    return {parse_key(str(key)): float(number) for key, number in value.items()}


def _ids(name: str, value: Any) -> dict[Key, int]:
    ids = {key: int(number) for key, number in _by_sensor(name, value, "a device id").items()}
    if any(not 0 < number < 2**31 for number in ids.values()):
        raise InvalidInputError(f"option {name} of a plan: a device id is a whole number from 1 to {2**31 - 1}")
    return ids


def _rotations(name: str, value: Any) -> dict[Key, int]:
    found = _by_sensor(name, value, "the number of a rotation")
    if any(key[0] != Sensor.MAG or number < 0 or not number.is_integer() for key, number in found.items()):
        raise InvalidInputError(f"option {name} of a plan is of compasses, by the firmware's number, not {value!r}")
    return {key: int(number) for key, number in found.items()}


def _temperatures(name: str, value: Any) -> dict[int, float]:
    found = _by_sensor(name, value, "a temperature in degC")
    wrong = [key_text(*key) for key in found if key[0] != Sensor.ACCEL]
    if wrong or any(not -70.0 <= t <= 150.0 for t in found.values()):
        raise InvalidInputError(f"option {name} of a plan is of accelerometers, -70 to 150 degC, not {value!r}")
    return {instance: t for (_, instance), t in found.items()}


PLAN_OPTIONS: Final[Mapping[str, PlanOption]] = MappingProxyType(
    {
        option.name: option
        for option in (
            PlanOption("only", _sensors, "Plan for these sensors alone, as gyro0,accel0."),
            PlanOption("keep_gyro_at_boot", _switch, "ArduPilot: keep the gyro offsets at boot (INS_GYR_CAL = 0)."),
            PlanOption("mark_calibrated", _switch, "ArduPilot: mark the sensors as calibrated after the write."),
            PlanOption("adjust_level", _switch, "Carry the level trim over to a new accelerometer calibration."),
            PlanOption("confirm_mounting", _switch, "Confirm that a compass is mounted as the job found it."),
            PlanOption("mountings", _rotations, "Mounting of a compass by the firmware's number, as mag0=6."),
            PlanOption(
                "confirm_other_unit",
                _switch,
                "Confirm that a recording without board id is of this vehicle.",
                live=False,
            ),
            PlanOption("device_ids", _ids, "PX4: device id of a sensor, which no stream says, as gyro0=1310988."),
            PlanOption(
                "accel_temperature", _temperatures, "PX4: degC at which CAL_ACC in force was taken, as accel0=31.5."
            ),
        )
    }
)
"""By name. :attr:`ComposeOptions.unproved_origin` is a fact, not a decision, and no option."""

CONFIRMATIONS: Final = tuple(name for name in PLAN_OPTIONS if name.startswith("confirm_"))
"""Options that confirm what only the operator can know; the audit keeps who did."""


def compose_options(data: Mapping[str, Any], **facts: Any) -> ComposeOptions:
    """Options from plain `data`; `facts` fill those that the operator did not give.

    Raises
    ------
    InvalidInputError
        If a name is unknown or a value is not of its kind.
    """
    for name in data:
        if name not in PLAN_OPTIONS:
            raise InvalidInputError(f"a plan has no option {name}; its options are: {', '.join(PLAN_OPTIONS)}")
    chosen = {name: PLAN_OPTIONS[name].read(name, value) for name, value in data.items()}
    return ComposeOptions(**{**facts, **chosen})
