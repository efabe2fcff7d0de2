"""What is asked of the service."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mavcal.client.base import Number, Request


class PlanOptions(Request):
    """What the operator decides about a plan; sensors are named gyro0 (the first gyro), accel1, mag0."""

    only: list[str] = Field(default_factory=list)
    """Plan for these sensors alone; empty: for all that were fitted."""
    keep_gyro_at_boot: bool = False
    """ArduPilot: keep the gyro offsets (INS_GYR_CAL = 0)."""
    mark_calibrated: bool = True
    """ArduPilot: mark the sensors as calibrated."""
    adjust_level: bool = True
    """Carry the level trim over to a new accelerometer calibration."""
    confirm_mounting: bool = False
    """A compass really is mounted as the job found it."""
    mountings: dict[str, int] = Field(default_factory=dict)
    """Mounting of a compass that its movement did not show, by the firmware's number."""
    confirm_other_unit: bool = False
    """A recording without a board id is of this vehicle; the audit keeps it."""
    device_ids: dict[str, int] = Field(default_factory=dict)
    """PX4: device id that no stream says, by sensor."""
    accel_temperature: dict[str, Number] = Field(default_factory=dict)
    """PX4: degC at which CAL_ACC in force was taken, by sensor."""


class ReadingOptions(Request):
    """How an uploaded file is to be read; as the options of `mavcal fit`."""

    mapping: dict[str, str] = Field(default_factory=dict)
    """Canonical column: header name or 0-based number, with an optional *factor."""
    world: Literal["ned", "enu"] = "ned"
    body: Literal["frd", "flu"] = "frd"
    rate: Number | None = None
    """Makes `t`, Hz."""
    unit_accel: str = "si"
    unit_gyro: str = "si"
    unit_mag: str = "uT"
    system: int | None = None
    """Which vehicle of a telemetry log."""
