"""Reports of flights as a diagnosis would give them: a weak motor, another drag, a windy day without a gap.

Sizes are those of simulated ArduPilot quads in frame plus: thrust over mass 25.15 m/s2 at full command, rotor drag
0.245 1/s in hover, roll and pitch gain 286 rad/s2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import (
    AirframePart,
    AirframeTrace,
    Commands,
    Domain,
    Geometry,
    Motor,
    Quantity,
    Rollout,
    RolloutStep,
)
from mavcal.calib.gap.schema import (
    EffectEstimate,
    EffectEvidence,
    GapReport,
    GapVerdict,
    Gates,
    MultipleTesting,
    NotTestable,
    ParameterEstimate,
    Rival,
)
from tests.unit.gap.export.making import report

Array = NDArray[np.float64]
PLUS = Geometry("quad", "plus", (Motor(0, 1, 1), Motor(0, -1, 1), Motor(1, 0, -1), Motor(-1, 0, -1)), "parameters")
REBUILT = Commands("rate_mixer", 400.0, 0.5, 0.021)
DOMAINS: Mapping[str, Domain] = {
    **dict.fromkeys(
        ("thrust_scale", "thrust_expo", "motor_lag", "actuator_delay", "motor_weak", "rotor_drag", "body_drag",
         "inflow", "translational_lift", "inertia", "cg_offset", "torque_bias", "yaw_coefficient", "angular_damping",
         "battery_sag", "payload_step"),
        Domain.AIRFRAME,
    ),
    **dict.fromkeys(
        ("air_density", "ground_effect", "wind", "turbulence", "gust", "gps_glitch", "ekf_reset"), Domain.ENVIRONMENT
    ),
}  # fmt: skip
"""Every effect of airframe and air by its id."""


def relative(name: str, real: float, sim: float, half: float) -> ParameterEstimate:
    """A ratio of both sides whose 95 % interval is so wide to either side."""
    ratio = real / sim
    ci = (ratio - half, ratio + half)
    return ParameterEstimate(name, ratio - 1, half / 1.96, (ci[0] - 1, ci[1] - 1), "1", real, sim, ratio, ci)


def absolute(name: str, real: float, sim: float, half: float, unit: str) -> ParameterEstimate:
    """A difference of both sides."""
    value = real - sim
    return ParameterEstimate(name, value, half / 1.96, (value - half, value + half), unit, real, sim)


def stated(name: str, value: float, unit: str = "1") -> ParameterEstimate:
    """A parameter that has a value only."""
    return ParameterEstimate(name, value, 0.0, (value, value), unit)


def flown(id_: str, *params: ParameterEstimate, instances: tuple[int, ...] = (), share: float = 0.5) -> EffectEstimate:
    """An effect of airframe or air that is nearly sure."""
    evidence = EffectEvidence(2400.0, len(params), 1e-9, 0.97, share)
    return EffectEstimate(id_, None, instances, params, evidence, gates=Gates(heldout_blocks=True), domain=DOMAINS[id_])


CENTRE = flown("cg_offset", absolute("x", 0.048, 0.0, 0.004, "1"), absolute("y", -0.028, 0.0, 0.005, "1"))
DRAG = flown("rotor_drag", relative("c1", 0.392, 0.245, 0.06))
WIND = flown("wind", absolute("north", -1.09, 0.05, 0.08, "m/s"), absolute("east", -4.0, 0.01, 0.1, "m/s"))
TURBULENCE = flown("turbulence", absolute("sigma", 0.49, 0.02, 0.06, "m/s2"))
WEAK = replace(
    flown("motor_weak", relative("s", 0.921, 1.0, 0.005), stated("motor", 3.0), instances=(3,), share=0.9),
    confusable_with=(
        Rival("cg_offset", 0.86, 48.0, "hover at two thrusts, 20 % apart: a shifted centre goes with the thrust"),
        Rival("torque_bias", 0.81, 61.0, "roll and pitch doublets: a weak motor changes the gain of its axis too"),
    ),
    sim_patch={"SIM_ENGINE_FAIL": 4.0, "SIM_ENGINE_MUL": 0.96},
)


def rollouts(*found: str, closed: float = 0.94) -> tuple[Rollout, ...]:
    """Velocity and body rate after the usual times, closed by the effects one after the other."""
    sizes = [
        (0.5, Quantity.VELOCITY, "m/s", 0.41, 0.05),
        (1.0, Quantity.VELOCITY, "m/s", 0.82, 0.10),
        (2.0, Quantity.VELOCITY, "m/s", 1.58, 0.21),
        (0.1, Quantity.BODY_RATE, "rad/s", 0.21, 0.03),
        (0.2, Quantity.BODY_RATE, "rad/s", 0.44, 0.07),
    ]
    made = []
    for h, quantity, unit, before, floor in sizes:
        before = before if found else 1.15 * floor
        ends = [
            before - (before - floor) * closed * share for share in np.linspace(0.0, 1.0, len(found) + 1)[1:] ** 0.3
        ]
        steps = tuple(RolloutStep(name, float(end)) for name, end in zip(found, ends, strict=True))
        after = steps[-1].error if steps else before
        part = closed if steps else None
        made.append(
            Rollout(h, quantity, unit, before, after, floor, part, part and (part - 0.03, part + 0.02), sequence=steps)
        )
    return tuple(made)


def traces(force: tuple[float, float, float], torque: tuple[float, float, float]) -> tuple[AirframeTrace, ...]:
    """A minute of doublets and runs; the simulator lacks so much of each axis, the patched one has it."""
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 60.0, 0.01)
    runs = np.clip(np.sin(0.35 * t) * 1.6, -1.0, 1.0)
    burst = np.sin(2 * np.pi * 1.1 * t) * (np.sin(0.35 * t + 1.0) > 0.6)
    of_force = np.stack([2.4 * runs, 1.2 * np.roll(runs, 700), -9.81 + 1.3 * np.sin(0.8 * t)], axis=1)
    of_torque = np.stack([14.0 * burst, 11.0 * np.roll(burst, 500), 1.4 * np.roll(runs, 300)], axis=1)
    made = []
    for kind, unit, real, part, noise in (
        ("force", "m/s2", of_force, force, 0.12), ("torque", "rad/s2", of_torque, torque, 0.9),
    ):  # fmt: skip
        lacks = np.asarray(part)
        seen = real + noise * rng.normal(size=real.shape)
        seen[2000:2040] = np.nan  # an output at its limit
        made.append(AirframeTrace(kind, unit, t, seen, real * (1.0 - lacks), real * (1.0 - 0.05 * lacks)))
    return tuple(made)


def weak_motor() -> GapReport:
    """Motor 3 has lost 8 % of its thrust; a shifted centre of gravity is its rival."""
    part = AirframePart(
        PLUS, REBUILT, rollouts("motor_weak"), (0.01, -0.04),
        ("Hover 10 s, then climb and descend at 3 m/s twice: the total thrust must change by 20 %.",
         "Six roll and six pitch doublets of 20 deg."),
        traces((0.0, 0.0, 0.02), (0.06, 0.22, 0.05)), {"hover_throttle_real": 0.401, "hover_throttle_sim": 0.390},
    )  # fmt: skip
    return replace(_explained(WEAK), airframe=part)


def drag_flight() -> GapReport:
    """Another rotor drag and a shifted centre of gravity, on a calm day."""
    part = AirframePart(
        PLUS, REBUILT, rollouts("rotor_drag", "cg_offset", closed=0.91), (-0.01, -0.02), (),
        traces((0.35, 0.35, 0.0), (0.1, 0.1, 0.0)),
    )  # fmt: skip
    return replace(_explained(DRAG, CENTRE), airframe=part)


def windy_null() -> GapReport:
    """Nothing wrong with the vehicle; wind of 4.2 m/s from 75 degrees."""
    gone = NotTestable(
        "motor_lag", "commands are known at 10 Hz only", "LOG_BITMASK bits 0 and 18 (fast attitude, fast IMU)"
    )
    slow = replace(REBUILT, source="rcou", rate_hz=10.0, check_us=None, masked=0.0)
    part = AirframePart(PLUS, slow, rollouts(), (-1.09, -4.0), traces=traces((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    whole = replace(_explained(WIND, TURBULENCE), verdict=GapVerdict.NO_GAP)
    return replace(whole, airframe=part, not_testable=(gone,))


def _explained(*effects: EffectEstimate) -> GapReport:
    whole = report(*effects)
    inputs = replace(whole.inputs, sim_sha256="ef" * 32, fs_hz=400.0, duration_s=143.0, reference_text="two flights")
    return replace(whole, inputs=inputs, multiple_testing=MultipleTesting(61, 0.005))
