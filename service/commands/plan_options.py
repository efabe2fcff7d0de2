"""The options of a plan on the command line, stated here so that help does without numpy (a test compares them)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from mavcal.client.requests import PlanOptions

Command = TypeVar("Command", bound=Callable[..., Any])

_OPTIONS = (
    click.option("--only", metavar="SENSORS", help="Plan for these sensors alone, as gyro0,accel0 (from 0)."),
    click.option("--keep-gyro-at-boot", is_flag=True, help="ArduPilot: keep the gyro offsets (INS_GYR_CAL = 0)."),
    click.option(
        "--mark-calibrated/--no-mark-calibrated", default=None, help="ArduPilot: mark the sensors as calibrated."
    ),
    click.option(
        "--adjust-level/--no-adjust-level",
        default=None,
        help="Carry the level over to a new accelerometer calibration.",
    ),
    click.option("--confirm-mounting", is_flag=True, help="Confirm that a compass is mounted as the job finds it."),
    click.option("--mountings", metavar="SENSOR=NUMBER,...", help="Mounting of a compass, by the number."),
    click.option("--device-ids", metavar="SENSOR=ID,...", help="PX4: device id of a sensor, which no stream says."),
    click.option(
        "--accel-temperature", metavar="SENSOR=DEGC,...", help="PX4: temperature at which CAL_ACC in force was taken."
    ),
)
NAMES = (
    *("only", "keep_gyro_at_boot", "mark_calibrated", "adjust_level"),
    *("confirm_mounting", "mountings", "device_ids", "accel_temperature"),
)
"""Those that a live job can have."""
OF_RECORDINGS = ("confirm_other_unit",)
"""Those that only a job of a recording can have."""
_other_unit = click.option(
    "--confirm-other-unit", is_flag=True, help="Confirm that a recording without board id is of this vehicle."
)
_TWO_WAYS = frozenset({"mark_calibrated", "adjust_level"})
"""Switches that can be given either way; the others are only ever switched on."""


def plan_options(command: Command) -> Command:
    """Add every option of a plan that a live job can have."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def all_plan_options(command: Command) -> Command:
    """Add every option of a plan, those of recordings included."""
    return plan_options(_other_unit(command))


def given(options: dict[str, Any]) -> dict[str, Any]:
    """The plan's options that were given, as plain data; they are removed from `options`."""
    named = {name: options.pop(name) for name in (*NAMES, *OF_RECORDINGS) if name in options}
    found = {n: v for n, v in named.items() if v is not None and (v is not False or n in _TWO_WAYS)}
    if "only" in found:
        found["only"] = [part for part in found["only"].split(",") if part]
    for name in ("mountings", "device_ids", "accel_temperature"):
        if name in found:
            found[name] = _pairs(name, found[name])
    return found


def options_of_plan(given: dict[str, Any]) -> PlanOptions:
    """Options of a plan as the client takes them. Raises InvalidInputError."""
    from pydantic import ValidationError

    from mavcal.calib.errors import InvalidInputError
    from mavcal.client.requests import PlanOptions

    try:
        return PlanOptions(**given)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(str(part) for part in e['loc'])}: {e['msg']}" for e in error.errors())
        raise InvalidInputError(f"the options of the plan are not valid: {faults}") from None


def _pairs(name: str, text: str) -> dict[str, float]:
    found = {}
    for item in text.split(","):
        key, equals, value = item.partition("=")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise click.UsageError(f"--{name.replace('_', '-')}: {item!r} is not SENSOR=NUMBER, as accel0=31.5")
    return found
