"""Errors of a simulated sensor that represent the effects of a report, and the effects that they cannot represent.

The diagnosis states ``measured = A ideal + b + p(T)``, where `ideal` is the reading of the present simulator, ``ideal =
M x + b_0``. The calibration in force removes `h`. The sensor to simulate is therefore ``A M x + A (b_0 - h) + h + b``.
A simulator's offsets are those that its calibration cancels (``h = b_0``), which leaves ``A M x + b_0 + b``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.fit import AXES
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.traits import SensorTerm
from mavcal.calib.gap.schema import EffectEstimate
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.sensor import SensorErrors

Array = NDArray[np.float64]

_SYMMETRIC = ("xx", "yy", "zz", "xy", "xz", "yz")
REFERENCE_TEMPERATURE = 35.0
"""Default reference temperature of drifts, degC: the middle of the range of a simulator without its own setting (TMIN
0, TMAX 70). Source: FLIGHT_CONTROLLERS 7.1."""
TEMPERATURE_TERMS = frozenset({SensorTerm.TEMPERATURE_CURVE, SensorTerm.TEMPERATURE_SCALE})
"""Terms that are stated at a reference temperature."""


def term_of(effect: EffectEstimate) -> SensorTerm | None:
    """The term of the sensor equation that it changes; None if it has none or is not in the catalogue."""
    known = by_id().get(effect.id)
    return known.term if known is not None else None


def value(effect: EffectEstimate, name: str) -> float:
    """The parameter of that name; 0 where the effect has none."""
    return next((p.value for p in effect.params if p.name == name), 0.0)


def vector(effect: EffectEstimate, name: str) -> Array:
    """``name.x name.y name.z`` (3,); 0 where the effect has none."""
    return np.array([value(effect, f"{name}.{axis}") for axis in AXES])


def named(effect: EffectEstimate) -> str:
    """The effect and its instances in words: ``accel_bias of instance 1``."""
    numbers = ", ".join(map(str, effect.instances))
    if effect.sensor is None:
        return f"{effect.id} of motor {numbers}" if numbers else effect.id
    return f"{effect.id} of instance{'s' if len(effect.instances) > 1 else ''} {numbers}"


def sensor_effects(effects: Iterable[EffectEstimate]) -> tuple[EffectEstimate, ...]:
    """Effects of a sensor."""
    return tuple(e for e in effects if e.sensor is not None)


def doubt_text(effect: EffectEstimate) -> str:
    """Notice of a doubtful effect."""
    return f"{named(effect)}: it has a probability of {effect.evidence.probability:.2f}: something else is likelier"


@dataclass(frozen=True, eq=False)
class SensorEffects:
    """Sensors of the vehicle with their effects, by sensor and instance (from 1), and the remaining effects."""

    errors: Mapping[tuple[Sensor, int], SensorErrors]
    rest: tuple[EffectEstimate, ...]

    def of(self, sensor: Sensor, instance: int) -> SensorErrors:
        """The errors of one sensor; an ideal one without effects."""
        return self.errors.get((sensor, instance), SensorErrors())

    @property
    def instances(self) -> tuple[int, ...]:
        """Numbers of the instances that an effect is on."""
        return tuple(sorted({instance for _, instance in self.errors}))


def sensors_with(
    effects: Iterable[EffectEstimate],
    base: Mapping[tuple[Sensor, int], SensorErrors] | None = None,
    *,
    t_ref: float = REFERENCE_TEMPERATURE,
) -> SensorEffects:
    """The sensors that a simulator should have.

    Parameters
    ----------
    effects
        Of a report.
    base
        The simulator's present sensors by sensor and instance; None: ideal ones.
    t_ref
        Reference temperature of drifts, degC; the value there of a drift with another reference becomes part of the
        bias.
    """
    groups: dict[tuple[Sensor, int], list[EffectEstimate]] = {}
    rest = []
    for effect in effects:
        if effect.sensor is None or term_of(effect) is None:
            rest.append(effect)
            continue
        for instance in effect.instances:
            groups.setdefault((effect.sensor, instance), []).append(effect)
    known = base or {}
    made = {key: _with(known.get(key, SensorErrors()), found, t_ref) for key, found in groups.items()}
    return SensorEffects(made, tuple(rest))


def _with(base: SensorErrors, effects: Sequence[EffectEstimate], t_ref: float) -> SensorErrors:
    base = recentred(base, t_ref)
    turn = np.eye(3)
    bias, curve = np.zeros(3), np.zeros((3, 3))
    steps: dict[str, Any] = {}
    for effect in effects:
        match term_of(effect):
            case SensorTerm.BIAS:
                bias += vector(effect, "bias")
            case SensorTerm.HARD_IRON:
                bias += vector(effect, "hard_iron")
            case SensorTerm.SCALE | SensorTerm.MISALIGNMENT | SensorTerm.SOFT_IRON | SensorTerm.ROTATION:
                turn += matrix_of(effect)
            case SensorTerm.TEMPERATURE_CURVE:
                at, slopes = _about(effect, t_ref)
                bias, curve = bias + at, curve + slopes
            case SensorTerm.THERMAL_LAG:
                curve[:, 0] += vector(effect, "per_degc")
                steps["thermal_lag"] = -value(effect, "lag_s")  # the sensor is behind the thermometer, not before it
            case SensorTerm.TEMPERATURE_SCALE:
                growth = vector(effect, "scale_per_degc")
                steps["temperature_scale"] = growth
                turn += np.diag(growth * (t_ref - value(effect, "t_ref")))
            case _:
                steps |= _sized(effect, base)
    degree = max(base.temperature.shape[1], 3)
    temperature = np.zeros((3, degree))
    temperature[:, : base.temperature.shape[1]] = base.temperature
    temperature[:, :3] += curve
    return dataclasses.replace(
        base, bias=base.bias + bias, matrix=turn @ base.matrix, temperature=temperature, t_ref=t_ref, **steps
    )


def matrix_of(effect: EffectEstimate) -> Array:
    """What a matrix effect adds to the identity (3, 3)."""
    term = term_of(effect)
    if term is SensorTerm.ROTATION:
        turn = Rotation.from_rotvec(vector(effect, "rotation")).as_matrix()
        return np.asarray(turn - np.eye(3), dtype=np.float64)
    if term is SensorTerm.SCALE:
        return np.diag(vector(effect, "scale"))
    found = np.zeros((3, 3))
    for i, row in enumerate(AXES):
        for j, column in enumerate(AXES):
            if term is SensorTerm.SOFT_IRON:
                name = row + column if row + column in _SYMMETRIC else column + row
                found[i, j] = value(effect, f"soft_iron.{name}")
            else:
                found[i, j] = value(effect, f"misalignment.{row}{column}")
    return found


def recentred(errors: SensorErrors, t_ref: float) -> SensorErrors:
    """The same sensor with its drift stated about `t_ref` (degC)."""
    if not errors.temperature.any():
        return errors
    shift = np.polynomial.Polynomial([t_ref - errors.t_ref, 1.0])
    curves = [np.polynomial.Polynomial([0.0, *row])(shift) for row in errors.temperature]
    size = errors.temperature.shape[1] + 1
    table = np.array([np.pad(c.coef, (0, size - len(c.coef))) for c in curves])
    return dataclasses.replace(errors, bias=errors.bias + table[:, 0], temperature=table[:, 1:], t_ref=t_ref)


def _about(effect: EffectEstimate, t_ref: float) -> tuple[Array, Array]:
    """Value (3,) at `t_ref`, and the coefficients (3, 3) about it (FLIGHT_CONTROLLERS 7.1)."""
    d = t_ref - value(effect, "t_ref")
    c1, c2, c3 = (vector(effect, name) for name in ("per_degc", "per_degc2", "per_degc3"))
    coefficients = np.column_stack([c1 + 2.0 * c2 * d + 3.0 * c3 * d**2, c2 + 3.0 * c3 * d, c3])
    return c1 * d + c2 * d**2 + c3 * d**3, coefficients


def _sized(effect: EffectEstimate, base: SensorErrors) -> dict[str, Any]:
    """Noise, g-sensitivity, range and resolution; noise adds in power to the simulator's."""
    match term_of(effect):
        case SensorTerm.WHITE_NOISE:
            return {"noise_density": np.hypot(base.noise_density, vector(effect, "density"))}
        case SensorTerm.FLICKER:
            return {"bias_instability": np.hypot(base.bias_instability, vector(effect, "instability"))}
        case SensorTerm.RANDOM_WALK:
            return {"random_walk": np.hypot(base.random_walk, vector(effect, "random_walk"))}
        case SensorTerm.G_SENSITIVITY:
            rows = [[value(effect, f"g_sensitivity.{r}{c}") for c in AXES] for r in AXES]
            return {"g_sensitivity": np.array(rows)}
        case SensorTerm.FULL_SCALE:
            return {"full_scale": value(effect, "limit")}
        case _:
            return {"resolution": float(vector(effect, "lsb").max())}
