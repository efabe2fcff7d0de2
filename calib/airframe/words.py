"""Manoeuvres that tell effects apart, by effect (AIRFRAME 5.6, 5.10)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

STANDARD_FLIGHT: Final = (
    "rest 10 s with logging; hover 10 s at 5 m; three climbs and descents at 2 to 4 m/s; out and back at 4 and 8 m/s "
    "along x and along y; four yaw steps of 90 degrees; 5 s of sharp roll and pitch doublets; hover; a slow landing; "
    "rest 5 s"
)
"""The standard flight of 90 s; it shows every effect but those of :data:`BESIDE_STANDARD`. Source: AIRFRAME 5.10."""
FIXES: Final[Mapping[str, str]] = {
    "thrust_scale": "throttle steps over 0.3, and 10 s of rest before arming for the accelerometer's own scale",
    "thrust_expo": "throttle steps over 0.3: climbs and descents at 2 to 4 m/s",
    "motor_lag": "sharp roll and pitch doublets, or a chirp to 10 Hz (SID_AXIS 10 to 12)",
    "actuator_delay": "sharp roll and pitch doublets, or a chirp to 10 Hz (SID_AXIS 10 to 12)",
    "motor_weak": "roll and pitch doublets and a hover at two throttles",
    "rotor_drag": "runs out and back at 4 and 8 m/s along x and y",
    "body_drag": "runs out and back at 4 and 8 m/s along x and y",
    "inflow": "climbs and descents at 2 to 4 m/s",
    "translational_lift": "level runs at 8 m/s and more",
    "inertia": "sharp doublets about the axis",
    "cg_offset": "a hover at two throttles: a shifted centre of mass turns with the thrust",
    "torque_bias": "a hover at two throttles: a constant torque does not change with the thrust",
    "yaw_coefficient": "four yaw steps of 90 degrees: damping tells reaction from inertia",
    "angular_damping": "fast turns about the axis, beside doublets",
    "battery_sag": "a flight over the whole battery with the same hover before and after",
    "payload_step": "a hover before and after the load is dropped",
    "air_density": "at an altitude 500 m apart with the barometer logged, or with the simulator at the altitude of "
    "this air (SIM_OPOS_ALT)",
    "ground_effect": "20 s of hover with the rotors 0.3 m above the ground and a slow landing, with a rangefinder, in "
    "both flights",
    "wind": "runs out and back, and a turn through all headings",
}
BESIDE_STANDARD: Final = frozenset({"air_density", "ground_effect"})
"""Effects that the standard flight does not show."""
