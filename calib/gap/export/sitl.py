"""A report as parameters of ArduPilot's simulator, on top of those that it has (FLIGHT_CONTROLLERS 7.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.export.airframe import airframe_effects, own_patches
from mavcal.calib.gap.export.sensor_errors import (
    REFERENCE_TEMPERATURE,
    SensorEffects,
    doubt_text,
    named,
    sensor_effects,
    sensors_with,
    term_of,
    value,
    vector,
)
from mavcal.calib.gap.schema import EffectEstimate, GapReport
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.recording import SensorSuite
from mavcal.calib.simulate.sensor import SensorErrors
from mavcal.calib.simulate.sitl import UT_PER_MGAUSS, from_sitl, to_sitl

Array = NDArray[np.float64]

DEFAULTS: Mapping[str, float] = {
    f"SIM_MAG{n}_OFS_{axis}": offset for n in (1, 2, 3) for axis, offset in zip("XYZ", (5.0, 13.0, -18.0), strict=True)
}
"""Parameters of a fresh simulator; its sensors are otherwise ideal. Source: FLIGHT_CONTROLLERS 7.1."""

COMPASS_RATE = 100.0
"""Rate, Hz, at which SITL draws a compass' noise, before the firmware averages. Source: ArduPilot's AP_Compass_SITL."""
_FAR = 1e6
"""Height, m, of a practically uniform anomaly. Source: FLIGHT_CONTROLLERS 7.1, its field falls as (HGT/(h + HGT))^3; at
1 km by 0.3 %."""
_ON_TOP = ("SIM_MAG_MOT", "SIM_MAG_DELAY", "SIM_IMU_POS")
"""Parameters to which an effect is added; other parameters of the whole vehicle are replaced."""
_ACTIVE = 0.3
"""Share of the strongest axis' amplitude that counts as a vibration. Chosen, not measured: SITL has one amplitude for
all axes, and a weak axis is nearer to none."""
_INSTANCES = {Sensor.ACCEL: 5, Sensor.GYRO: 5, Sensor.MAG: 3}
"""Instances that the simulator has. Source: FLIGHT_CONTROLLERS 7.1."""

_FAMILIES: Mapping[str, tuple[str, ...]] = {
    "accel_bias": ("SIM_ACC#_BIAS",),
    "accel_scale": ("SIM_ACC#_SCAL",),
    "accel_temp_linear": ("SIM_ACC#_BIAS", "SIM_IMUT#"),
    "accel_temp_poly": ("SIM_ACC#_BIAS", "SIM_IMUT#"),
    "gyro_bias": ("SIM_GYR#_BIAS",),
    "gyro_scale": ("SIM_GYR#_SCALE",),
    "gyro_temp_linear": ("SIM_GYR#_BIAS", "SIM_IMUT#"),
    "gyro_temp_poly": ("SIM_GYR#_BIAS", "SIM_IMUT#"),
    "mag_hard_iron": ("SIM_MAG#_OFS",),
    "mag_soft_iron": ("SIM_MAG#_DIA", "SIM_MAG#_ODI"),
}
"""Effects that are a sensor's own parameters, and which."""

_OLDER = {
    "SIM_MAG1_OFS": "SIM_MAG_OFS",
    "SIM_MAG1_DIA": "SIM_MAG_DIA",
    "SIM_MAG1_ODI": "SIM_MAG_ODI",
}
_OLDEST = {
    "SIM_ACC1_BIAS": "SIM_ACC_BIAS",
    "SIM_ACC1_RND": "SIM_ACC_RND",
    "SIM_GYR1_RND": "SIM_GYR_RND",
    "SIM_GYR1_SCALE": "SIM_GYR_SCALE",
}
"""Names of the first instance up to 4.1, and up to 4.0."""


@dataclass(frozen=True)
class SitlPatch:
    """Simulator parameters, what they cannot hold, and notes."""

    values: Mapping[str, float]
    not_held: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())


def with_patches(
    report: GapReport,
    base: Mapping[str, float] | None = None,
    *,
    frame: Mapping[str, Any] | None = None,
    mass: float | None = None,
    vehicle: Mapping[str, float] | None = None,
) -> GapReport:
    """`report` with the simulator's settings in its effects: each has its part of all together, so that they add up.

    Effects of sensors carry SIM_* of :func:`patch`. The constant that a drift leaves at the middle of the simulator's
    range belongs to the bias, if there is one. Those of the airframe carry the result of
    :func:`calib.gap.export.airframe.own_patches`; those of the air carry nothing.

    Parameters
    ----------
    report
        A diagnosis.
    base
        Parameters of the simulator's log; None: a fresh ArduPilot simulator's.
    frame
        Keys of the frame file that it was flown with; None: the stock frame.
    mass
        Of the real vehicle, kg; None: not known.
    vehicle
        Parameters of the real vehicle; None: not known.
    """
    whole = patch(report, base).values
    biased = {(e.sensor, n) for e in report.effects if term_of(e) is SensorTerm.BIAS for n in e.instances}
    flying = airframe_effects(report.effects)
    geometry = None if report.airframe is None else report.airframe.geometry
    own = own_patches(flying, base or {}, frame, geometry=geometry, mass=mass, vehicle=vehicle)
    settings = {id(effect): part for effect, part in zip(flying, own, strict=True)}
    effects = []
    for effect in report.effects:
        if effect.sensor is None:
            effects.append(replace(effect, sim_patch=settings.get(id(effect), {})))
            continue
        names = list(patch_of((effect,), report, base).values)
        units = {(effect.sensor, n) for n in effect.instances}
        if term_of(effect) is SensorTerm.TEMPERATURE_CURVE and biased >= units:
            names = [name for name in names if "_BIAS" not in name]
        effects.append(replace(effect, sim_patch={name: whole[name] for name in names if name in whole}))
    return replace(report, effects=tuple(effects))


def patch(report: GapReport, base: Mapping[str, float] | None = None) -> SitlPatch:
    """All effects of sensors in `report` as one set of parameters."""
    return patch_of(report.effects, report, base)


def patch_of(
    effects: tuple[EffectEstimate, ...], report: GapReport, base: Mapping[str, float] | None = None
) -> SitlPatch:
    """Some effects of `report` as one set of parameters.

    Parameters
    ----------
    effects
        Effects for the simulator; those that are not of a sensor are left out.
    report
        Whose they are: it says how many instances there are.
    base
        ``SIM_*`` of the simulator as it is, to which the effects are added; None: a fresh one's.
    """
    effects = sensor_effects(effects)
    known = simulator_parameters(base)
    t_mid = 0.5 * (known.get("SIM_IMUT1_TMIN", 0.0) + known.get("SIM_IMUT1_TMAX", 2.0 * REFERENCE_TEMPERATURE))
    sensors = sensors_with(effects, _present(known), t_ref=t_mid)
    values: dict[str, float] = {}
    not_held: list[str] = []
    for effect in effects:
        _of_sensor(values, not_held, effect, sensors)
    for effect in effects:
        if effect.id in _SPECIAL:
            more, lost = _SPECIAL[effect.id](effect, sensors, report)
            more = {name: v + (known.get(name, 0.0) if name.startswith(_ON_TOP) else 0.0) for name, v in more.items()}
            taken = sorted(name for name, v in more.items() if values.get(name, v) != v)
            lost += [f"{', '.join(taken)} already used by another effect"] if taken else []
            values |= {name: v for name, v in more.items() if name not in taken}
            not_held += [f"{named(effect)}: {text}" for text in lost]
        elif effect.id not in _FAMILIES:
            not_held.append(f"{named(effect)}: {_reason(effect)}")
    return SitlPatch(_renamed(values, known), tuple(dict.fromkeys(not_held)), _notes(values, effects))


def simulator_parameters(base: Mapping[str, float] | None) -> dict[str, float]:
    """``SIM_*`` of `base`, a fresh simulator's where it has none."""
    found = {k: float(v) for k, v in (base or {}).items() if k.startswith("SIM_") and math.isfinite(float(v))}
    return found or dict(DEFAULTS)


def _present(known: Mapping[str, float]) -> dict[tuple[Sensor, int], SensorErrors]:
    """The simulator's present sensors."""
    present: dict[tuple[Sensor, int], SensorErrors] = {}
    if any(name.startswith(("SIM_ACC", "SIM_GYR", "SIM_MAG", "SIM_IMUT")) for name in known):
        for instance in range(max(_INSTANCES.values())):
            suite = from_sitl(known, instance=instance).suite
            present |= {(sensor, instance + 1): errors for sensor, errors in suite.by_sensor.items()}
    return present


def _of_sensor(values: dict[str, float], not_held: list[str], effect: EffectEstimate, sensors: SensorEffects) -> None:
    """Parameters of an effect's families, from the sensors with all effects."""
    families = _FAMILIES.get(effect.id, ())
    if effect.sensor is None:
        return
    for n in effect.instances if families else ():
        if n > _INSTANCES[effect.sensor]:
            not_held.append(f"{named(effect)}: the simulator has {_INSTANCES[effect.sensor]} instances")
            continue
        suite = SensorSuite(*(_shown(sensors.of(s, n), s) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)))
        try:
            made = to_sitl(suite, instance=n - 1)
        except InvalidInputError as error:
            not_held.append(f"{named(effect)}: {error}")
            continue
        wanted = [family.replace("#", str(n)) for family in families]
        values |= {name: v for name, v in made.values.items() if _belongs(name, wanted, effect.sensor)}


def _shown(errors: SensorErrors, sensor: Sensor) -> SensorErrors:
    """Errors for which :func:`to_sitl` has parameters; the others are listed elsewhere."""
    curve = errors.temperature if sensor != Sensor.MAG else np.zeros((3, 0))
    matrix = errors.matrix if sensor == Sensor.MAG else np.diag(np.diag(errors.matrix))
    if not curve.any():
        return SensorErrors(bias=errors.bias, matrix=matrix)
    return SensorErrors(bias=errors.bias, matrix=matrix, temperature=curve, t_ref=errors.t_ref)


def _belongs(name: str, wanted: list[str], sensor: Sensor) -> bool:
    other = {Sensor.ACCEL: "_GYR", Sensor.GYRO: "_ACC"}.get(sensor, "none")
    return any(name.startswith(family) and not (family.startswith("SIM_IMUT") and other in name) for family in wanted)


def _motor_current(
    effect: EffectEstimate, sensors: SensorEffects, report: GapReport
) -> tuple[dict[str, float], list[str]]:
    """``D^-1 (B + MOT I)``: one vector for all compasses, before the soft iron."""
    if not any(p.name.startswith("per_ampere") for p in effect.params):
        return {}, ["a field that follows the throttle: SIM_MAG_MOT follows the simulated current"]
    ahead = np.linalg.inv(sensors.of(Sensor.MAG, effect.instances[0]).matrix)
    missed = sorted(_all(report, Sensor.MAG) - set(effect.instances))
    lost = [f"SIM_MAG_MOT acts on every compass, also on {', '.join(map(str, missed))}"] if missed else []
    return _three("SIM_MAG_MOT", ahead @ vector(effect, "per_ampere") / UT_PER_MGAUSS), lost


def _vibration(effect: EffectEstimate, sensors: SensorEffects, report: GapReport) -> tuple[dict[str, float], list[str]]:
    """A sine on each axis while the motors run; SIM_ACCn_RND is the common amplitude of the axes that have it."""
    if not any(p.name == "frequency_hz" for p in effect.params):
        return {}, ["a wave that follows one rotor's speed"]
    tonal = by_id()[effect.id].tonal
    size = np.hypot(vector(effect, "cos"), vector(effect, "sin")) if tonal else np.abs(vector(effect, "amplitude"))
    active = size >= _ACTIVE * size.max()
    level = float(np.sqrt(np.mean(size[active] ** 2)))
    frequency = value(effect, "frequency_hz")
    values = _three("SIM_VIB_FREQ", np.where(active, frequency, 0.0))
    values |= {f"SIM_ACC{n}_RND": level for n in effect.instances}
    lost = []
    if size[active].max() > 1.2 * size[active].min() or size[~active].any():
        listed = ", ".join(f"{s:.3g}" for s in size)
        lost.append(f"one amplitude for all axes, not ({listed}) m/s2")
    if tonal:
        lost.append("the tone is there only while the motors run")
    return values, lost


def _lever(effect: EffectEstimate, sensors: SensorEffects, report: GapReport) -> tuple[dict[str, float], list[str]]:
    missed = sorted(_all(report, Sensor.ACCEL) - set(effect.instances))
    lost = [f"SIM_IMU_POS moves every accelerometer, also {', '.join(map(str, missed))}"] if missed else []
    return _three("SIM_IMU_POS", vector(effect, "lever_arm")), lost


def _delay(effect: EffectEstimate, sensors: SensorEffects, report: GapReport) -> tuple[dict[str, float], list[str]]:
    delay = 1000.0 * value(effect, "delay_s")
    if delay < 0.0:
        return {}, ["a sensor that is ahead of its reference cannot be simulated"]
    missed = sorted(_all(report, Sensor.MAG) - set(effect.instances))
    lost = [f"SIM_MAG_DELAY delays every compass, also {', '.join(map(str, missed))}"] if missed else []
    return {"SIM_MAG_DELAY": float(round(delay))}, lost


def _field(effect: EffectEstimate, sensors: SensorEffects, report: GapReport) -> tuple[dict[str, float], list[str]]:
    shift = np.array([value(effect, f"earth_field.{axis}") for axis in "ned"]) / UT_PER_MGAUSS
    return {**_three("SIM_MAG_ALY", shift), "SIM_MAG_ALY_HGT": _FAR}, []


def _compass_noise(
    effect: EffectEstimate, sensors: SensorEffects, report: GapReport
) -> tuple[dict[str, float], list[str]]:
    """Uniform compass noise: half width a has the variance a^2/3, drawn a hundred times a second."""
    density = vector(effect, "density")
    level = float(np.sqrt(np.mean(density**2)))
    lost = ["uniform noise in place of a normal one, the same on every compass and axis"]
    return {"SIM_MAG_RND": math.sqrt(3.0 * COMPASS_RATE) * level / UT_PER_MGAUSS}, lost


def _turn(effect: EffectEstimate, sensors: SensorEffects, report: GapReport) -> tuple[dict[str, float], list[str]]:
    if set(effect.instances) != _all(report, Sensor.ACCEL):
        return {}, ["SIM_ACC_TRIM turns every accelerometer alike"]
    trim = Rotation.from_rotvec(-vector(effect, "rotation"))  # the simulator applies its transpose
    return _three("SIM_ACC_TRIM", np.asarray(trim.as_euler("ZYX")[::-1])), []


_Special = Callable[[EffectEstimate, SensorEffects, GapReport], tuple[dict[str, float], list[str]]]
_SPECIAL: Mapping[str, _Special] = {
    "mag_motor_current": _motor_current,
    "accel_vibration": _vibration,
    "accel_aliasing": _vibration,
    "accel_tone": _vibration,
    "accel_lever_arm": _lever,
    "accel_rotation": _turn,
    "mag_delay": _delay,
    "mag_earth_field": _field,
    "mag_noise": _compass_noise,
}


def _all(report: GapReport, sensor: Sensor) -> set[int]:
    """All instances in the report."""
    seen = {i for fit in report.series if fit.sensor is sensor for i in fit.instances}
    return seen | {i for effect in report.effects if effect.sensor is sensor for i in effect.instances}


def _three(name: str, three: Array) -> dict[str, float]:
    return {f"{name}_{axis.upper()}": float(v) for axis, v in zip(AXES, three, strict=True)}


def _reason(effect: EffectEstimate) -> str:
    """Why SITL cannot hold an effect."""
    known = by_id().get(effect.id)
    if known is not None and known.traits & {Trait.BROADBAND, Trait.WANDERING}:
        return "SITL's noise is uniform and of a fixed size; SIM_ACC_FILE_RW and SIM_GYR_FILE_RW replay a recorded one"
    if term_of(effect) in {SensorTerm.MISALIGNMENT, SensorTerm.ROTATION}:
        return "SITL has no cross terms of a single sensor"
    if effect.id == "reference_attitude":
        return "an error of the reference, not of a sensor"
    return "SITL has no parameter for it"


def _notes(values: Mapping[str, float], effects: Sequence[EffectEstimate]) -> tuple[str, ...]:
    notes = [doubt_text(e) for e in effects if e.evidence.doubtful]
    if any(name.startswith("SIM_GYR") and "_BIAS" in name for name in values):
        notes.append("set INS_GYR_CAL to 0: otherwise the firmware removes a gyroscope's bias at boot")
    if any("_OFS_" in name for name in values):
        notes.append("set COMPASS_OFS to what the vehicle has: SITL copies SIM_MAG_OFS into it where it is zero")
    if any(name.startswith("SIM_IMUT") for name in values):
        notes.append("SIM_IMUT_START, SIM_IMUT_END and SIM_IMUT_TCONST make the temperature's course")
    if any(name.startswith("SIM_VIB") for name in values):
        notes.append("the vibration begins above SIM_INS_THR_MIN of throttle")
    return tuple(notes)


def _renamed(values: Mapping[str, float], known: Mapping[str, float]) -> dict[str, float]:
    """Parameters with the names of the simulator version of `known`."""
    old: dict[str, str] = {}
    if "SIM_MAG_OFS_X" in known:
        old |= _OLDER
    if "SIM_ACC_BIAS_X" in known:
        old |= _OLDER | _OLDEST
    return in_names(values, old)


def in_names(values: Mapping[str, float], old: Mapping[str, str]) -> dict[str, float]:
    """`values` with replaced beginnings of their names."""
    made = {}
    for name, v in values.items():
        begin = next((b for b in old if name == b or name.startswith(f"{b}_")), None)
        made[name if begin is None else old[begin] + name[len(begin) :]] = v
    return made


def older_names(values: Mapping[str, float]) -> dict[str, float]:
    """`values` in the names of ArduPilot 4.1 and before, where only the second and third compass have a number."""
    return in_names(values, _OLDER)
