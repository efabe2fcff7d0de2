"""Unnamed shapes: lines over covariates, products, readings of other sensors, low orders of a reading.

They compete with the catalogue and pay for their flexibility. A shape with many amplitudes is also tried in parts, by
axis and by signal: one significant amplitude would be lost among eighteen.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import EffectParameter, MeanEffect
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Setting, Term
from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

_FLEXIBLE = ("line", "time")
_KNOTS = 6
"""Knots of a broken line over a covariate. Chosen, not measured: enough for a bend and a saturation on either side."""
_KNOTS_TIME = 20
"""Knots of a broken line over time. Chosen, not measured: 3 s apart in a minute."""
_OUTER_SHARE = 0.01
"""Fraction of the samples beyond the last knots: an amplitude from a few of them would explode elsewhere. Chosen, not
measured: the knots then exclude the rarest hundredth at either end."""
_KNOT_DISTANCE = 1e-3
"""Distance of two knots, relative to the range of all, below which they are merged. Source: numerical; closer knots
make columns that are hardly independent."""
_APPROACHES_S = (3.0, 4.5, 7.0, 10.0, 15.0, 22.0, 33.0)
"""Time constants, s, of an exponential approach that begins with the recording. Chosen, not measured: a factor of 1.5
from one to the next, from electronics to a die."""
_SLOW_SLOPE = 0.1
"""Fraction of the rms slope below which a change has no direction. Chosen, not measured: noise decides its sign."""
_TRAVELS = (0.01, 0.03, 0.1, 0.3)
"""Backlash widths relative to the reading's range. Chosen, not measured: a factor of three from one to the next."""
_POINTS = 20_000
"""Samples of a series examined for backlash; a series of twice as many is thinned. Chosen, not measured: it bounds the
time."""
_HARMONICS = (2, 3, 4, 5)
"""Overtones, in multiples of the frequency of a wave. Chosen, not measured: higher ones of a wave that a catalogue
misses are weak."""
_HIGHEST = 0.4
"""Highest frequency relative to the rate; beyond, two bands of one series meet. Chosen, not measured: four fifths of
the Nyquist frequency."""
_DUTY_CYCLES = tuple(np.arange(0.1, 0.95, 0.05).round(2).tolist())
"""Parts of a period for which something may be switched on. Chosen, not measured: steps of a twentieth lose at most a
twentieth of a wave."""
_OFFSET = 0.2
"""Standard deviation of a signal, relative to its size, below which it is just an offset. Chosen, not measured: an
offset then takes 96 % of its power."""
_MATRICES = {
    (Sensor.ACCEL, "a"): {"accel_scale", "accel_misalignment"},
    (Sensor.GYRO, "w"): {"gyro_scale", "gyro_misalignment"},
    (Sensor.GYRO, "a"): {"gyro_g_sensitivity"},
    (Sensor.MAG, "m"): {"mag_soft_iron", "mag_rotation"},
}
"""Effects that together are any linear map of a vector to a sensor, and so include each of its entries."""
_OFFSETS = {Sensor.ACCEL: "accel_bias", Sensor.GYRO: "gyro_bias", Sensor.MAG: "mag_hard_iron"}
_SCALES = {Sensor.ACCEL: "accel_scale", Sensor.GYRO: "gyro_scale", Sensor.MAG: "mag_soft_iron"}
"""The simplest effects: without a name in the catalogue they are shapes, so that no other effect stands for them."""
_SINCE_START, _SINCE_POWER_UP = "time since the start", "time since power-up"
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class ShapeHypothesis:
    """A shape with many amplitudes, and its parts with the rows of its columns that they use."""

    whole: Hypothesis
    parts: tuple[tuple[Hypothesis, Rows], ...] = ()

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The shape and its parts."""
        return self.whole, *(h for h, _ in self.parts)


@dataclass(frozen=True, eq=False)
class _ShapeGroup:
    """Signals (q, N) that act on every axis alike, or with `each` signals (N, 3) of the single axes.

    `family` sets the price (:func:`calib.gap.search.evidence.price_of_kind`); `names` are those of single signals that
    are offered alone.
    """

    family: str
    text: str
    signals: Array
    names: tuple[str, ...] = ()
    each: bool = False


def shapes_of(setting: Setting, tones: Sequence[Term] = (), named: Collection[str] = ()) -> tuple[ShapeHypothesis, ...]:
    """Every shape of every sensor and instance, and the overtones of the waves `tones`.

    A shape whose parts all have a name among the effects `named` is omitted.
    """
    found: dict[object, ShapeHypothesis] = {}
    for view in setting.views:
        for instance, trace in view.traces.items() if not view.first else ():
            if instance not in view.weights:
                continue
            own = [t for t in tones if t.hypothesis.touches(view) and instance in t.hypothesis.instances]
            for group in (*_shape_groups(trace, named), *(g for tone in own for g in _periodic(trace, tone))):
                shape = _shape(trace, group, (instance,))
                found.setdefault(shape.whole.key, shape)
    for shape in _common_growth(setting):
        found.setdefault(shape.whole.key, shape)
    return tuple(found.values())


def _common_growth(setting: Setting) -> Iterator[ShapeHypothesis]:
    """Growth with time common to all instances of a sensor, of which each alone would explain a part."""
    for sensor in dict.fromkeys(view.sensor for view in setting.views):
        own = [view for view in setting.views if view.sensor is sensor and not view.first]
        units = tuple(sorted({i for view in own for i in view.weights}))
        if len(units) > 1:
            yield from (_shape(own[0].any_trace, group, units) for group in _growth_shapes(own[0].any_trace))


def is_broken_line(hypothesis: Hypothesis) -> bool:
    """Whether it is a broken line, which fits anything that its covariate drives."""
    return hypothesis.effect.family in _FLEXIBLE


def _shape_groups(trace: Trace, named: Collection[str]) -> Iterator[_ShapeGroup]:
    yield from _line_shapes(trace)
    for group in (*_linear_shapes(trace, named), *_product_shapes(trace), *_driver_shapes(trace)):
        swinging = [j for j, signal in enumerate(group.signals) if _is_no_offset(signal)]
        if swinging:
            names = tuple(group.names[j] for j in swinging) if group.names else ()
            yield replace(group, signals=group.signals[swinging], names=names)
    yield from _reading_shapes(trace)
    yield from _simplest_shapes(trace, named)


def _shape(trace: Trace, group: _ShapeGroup, instances: tuple[int, ...]) -> ShapeHypothesis:
    def made(text: str, rows: Rows, *, part: bool = False) -> Hypothesis:
        return Hypothesis(_effect(trace, text, group, rows, part=part), instances)

    q = 1 if group.each else len(group.signals)
    rows = np.arange(3 * q, dtype=np.intp)
    text, on = group.text, trace.sensor.value
    parts = [(made(f"{text} on {on}.{_AXES[c]}", rows[c::3], part=True), rows[c::3]) for c in range(3)]
    for j, name in enumerate(group.names):
        parts.append((made(f"{name} on {on}", rows[3 * j : 3 * j + 3], part=True), rows[3 * j : 3 * j + 3]))
        for c in range(3):
            one = rows[3 * j + c : 3 * j + c + 1]
            parts.append((made(f"{name} on {on}.{_AXES[c]}", one, part=True), one))
    return ShapeHypothesis(made(f"{text} on {on}", rows), tuple(parts))


def _resampled(trace: Trace, own: Trace, drawn: Array) -> Array:
    """The signal `drawn` at the times of `own`, interpolated to those of `trace`."""
    return drawn if np.array_equal(trace.t, own.t) else np.interp(trace.t, own.t, drawn)


def _effect(own: Trace, text: str, group: _ShapeGroup, rows: Rows, *, part: bool) -> MeanEffect:
    """An effect with the columns `rows` of a group along `own`; column ``3 q + axis`` is signal q on that axis."""
    sensor = own.sensor

    def columns(trace: Trace, _theta: float) -> Array:
        placed = np.zeros((len(rows), len(trace.t), 3))
        for k, row in enumerate(rows):
            signal, axis = divmod(int(row), 3)
            drawn = group.signals[:, axis] if group.each else group.signals[signal]
            placed[k, :, axis] = _resampled(trace, own, drawn)
        return placed

    def signals(trace: Trace, _theta: float) -> Array:
        return np.array([_resampled(trace, own, drawn) for drawn in group.signals])

    whole = not group.each and len(rows) == 3 * len(group.signals)
    wish = "a recording in which the covariate varies by itself"
    return MeanEffect(
        f"unknown:{'one ' * part}{group.family}:{text}",
        sensor,
        (EffectParameter("amplitude", ""),),
        text,
        wish,
        columns=columns,
        signals=signals if whole else None,
        family=group.family,
        part=part,
        traits=frozenset({Trait.GROWING} if group.text in (_SINCE_START, _SINCE_POWER_UP) else ()),
    )


def _line_shapes(trace: Trace) -> Iterator[_ShapeGroup]:
    """Broken lines over covariates."""
    for name, values, knots in _covariates(trace):
        signals = _hat_functions(values, trace.observed, knots)
        if signals is not None:
            yield _ShapeGroup("time" if name == "time" else "line", f"function of {name}", signals)


def _covariates(trace: Trace) -> Iterator[tuple[str, Array, int]]:
    for letter, vector in _vectors(trace):
        yield from ((f"{letter}_{_AXES[c]}", vector[:, c], _KNOTS) for c in range(3))
    for name, size in (("|a|", trace.force), ("|w|", trace.rate)):
        if size is not None:
            yield name, np.linalg.norm(size, axis=1), _KNOTS
    yield "time", trace.t, _KNOTS_TIME
    yield from ((name, scalar, _KNOTS) for name, scalar in _scalars(trace))


def _vectors(trace: Trace) -> Iterator[tuple[str, Array]]:
    for letter, vector in (("a", trace.force), ("w", trace.rate), ("dw", trace.spin), ("m", trace.field)):
        if vector is not None:
            yield letter, vector


def _scalars(trace: Trace) -> Iterator[tuple[str, Array]]:
    for name, scalar in (("temperature", trace.temperature), ("current", trace.current), ("throttle", trace.throttle)):
        if scalar is not None:
            yield name, scalar
    if trace.rotor_hz is not None:
        yield "rotor speed", trace.rotor_hz.mean(axis=1)
    if trace.temperature is not None:
        yield "the slope of temperature", np.gradient(trace.temperature, trace.t)


def _hat_functions(values: Array, observed: NDArray[np.bool_], knots: int) -> Array | None:
    """Hat functions over quantiles of a covariate; None if it hardly varies."""
    if not _varies(values, observed, 4 * knots):
        return None
    seen = values[observed]
    at = np.unique(np.quantile(seen, np.linspace(_OUTER_SHARE, 1.0 - _OUTER_SHARE, knots)))
    keep = np.concatenate([[True], np.diff(at) > _KNOT_DISTANCE * np.ptp(at)])
    at = at[keep]
    if len(at) < 3:
        return None
    clipped = np.clip(values, at[0], at[-1])
    return np.array([np.interp(clipped, at, unit) for unit in np.eye(len(at))])


def _varies(values: Array, observed: NDArray[np.bool_], least: int) -> bool:
    seen = values[observed]
    return len(seen) >= least and float(np.ptp(seen)) > 1e-9 * (abs(float(seen.mean())) + 1e-12)


def _is_no_offset(values: Array) -> bool:
    """Whether a signal differs from an offset."""
    return float(values.std()) > _OFFSET * math.sqrt(float((values**2).mean()))


def _linear_shapes(trace: Trace, named: Collection[str]) -> Iterator[_ShapeGroup]:
    """Readings of other sensors, and the rate of change of the field."""
    for letter, vector in _vectors(trace):
        own = _MATRICES.get((trace.sensor, letter))
        if own is not None and own <= set(named):
            continue
        names = tuple(f"{letter}_{axis}" for axis in _AXES)
        yield _ShapeGroup("linear", f"linear in {letter}", np.ascontiguousarray(vector.T), names)
    if trace.sensor is Sensor.MAG:
        change = np.ascontiguousarray(np.gradient(trace.ideal, trace.t, axis=0).T)
        yield _ShapeGroup("linear", "change of the field", change, tuple(f"dm_{axis}" for axis in _AXES))


def _product_shapes(trace: Trace) -> Iterator[_ShapeGroup]:
    """Products of two vectors, and of a scalar with the ideal reading: axes that rotate or scale with a covariate."""
    vectors = dict(_vectors(trace))
    for one, other in (("a", "a"), ("w", "w"), ("a", "w")):
        if one in vectors and other in vectors:
            pairs = [(i, j) for i in range(3) for j in range(i if one == other else 0, 3)]
            signals = np.array([vectors[one][:, i] * vectors[other][:, j] for i, j in pairs])
            names = tuple(f"{one}_{_AXES[i]} times {other}_{_AXES[j]}" for i, j in pairs)
            yield _ShapeGroup("product", f"products of {one} and {other}", signals, names)
    own = {Sensor.ACCEL: "a", Sensor.GYRO: "w", Sensor.MAG: "m"}[trace.sensor]
    for name, scalar in (*_scalars(trace), ("time", trace.t)):
        signals = np.ascontiguousarray(((scalar - scalar.mean())[:, None] * trace.ideal).T)
        names = tuple(f"{name} times {own}_{axis}" for axis in _AXES)
        yield _ShapeGroup("product", f"{name} times {own}", signals, names)


def _driver_shapes(trace: Trace) -> Iterator[_ShapeGroup]:
    """First or second power of one covariate; current and charge of a battery; exponential approaches."""
    if trace.current is not None:
        charge = np.cumsum(trace.current) / trace.fs
        yield _ShapeGroup("driven", "current and charge", np.stack([trace.current, charge]), ("current", "charge"))
    for name, scalar in _scalars(trace):
        if name not in ("temperature", "current"):
            yield _ShapeGroup("driven", name, scalar[None])
        if name not in ("temperature", "the slope of temperature"):
            yield _ShapeGroup("driven", f"square of {name}", (scalar**2)[None])
    yield from _growth_shapes(trace)
    elapsed = trace.t - trace.t[0]
    for time in _APPROACHES_S:
        yield _ShapeGroup("approach", f"approach with {time:g} s", np.exp(-elapsed / time)[None])


def _growth_shapes(trace: Trace) -> Iterator[_ShapeGroup]:
    """Linear growth from the start of the recording, or from power-up, when an autopilot's clock starts."""
    start, span = float(trace.t[0]), float(trace.t[-1] - trace.t[0])
    yield _ShapeGroup("driven", _SINCE_START, (trace.t - start)[None])
    if 0.0 < start < span:
        yield _ShapeGroup("driven", _SINCE_POWER_UP, trace.t[None])


def _reading_shapes(trace: Trace) -> Iterator[_ShapeGroup]:
    """Functions of each axis' ideal reading: low orders, direction of change, and backlash."""
    x = trace.ideal
    size = np.sqrt((x**2).mean(axis=0)) + 1e-300
    slope = np.gradient(x, axis=0)
    steady = _SLOW_SLOPE * np.sqrt((slope**2).mean(axis=0)) + 1e-300
    orders = [
        ("square of the reading", (x / size) ** 2),
        ("cube of the reading", (x / size) ** 3),
        ("size of the reading", np.abs(x) / size),
        ("direction of the reading's change", np.tanh(slope / steady)),
        *(
            (f"dead travel of {part:.1%} of the range", pointer)
            for part, pointer in zip(_TRAVELS, _play_operator(x), strict=True)
        ),
    ]
    for name, signal in orders:
        swings = np.array([_is_no_offset(signal[:, c]) for c in range(3)])
        if swings.any():
            yield _ShapeGroup("own", name, signal * swings, each=True)


def _simplest_shapes(trace: Trace, named: Collection[str]) -> Iterator[_ShapeGroup]:
    """An offset and a factor of each axis, if the catalogue lacks them."""
    if _OFFSETS[trace.sensor] not in named:
        yield _ShapeGroup("simplest", "an offset", np.ones((1, len(trace.t))))
    if _SCALES[trace.sensor] not in named:
        x = trace.ideal
        yield _ShapeGroup(
            "simplest", "in proportion to the reading", x / (np.sqrt((x**2).mean(axis=0)) + 1e-300), each=True
        )


def _play_operator(x: Array) -> Array:
    """Position of a reading within the backlash, -1..1, for several widths (widths, N, 3).

    A long series is thinned.
    """
    every = max(1, len(x) // _POINTS)
    half = 0.5 * np.array(_TRAVELS)[:, None] * np.ptp(x, axis=0) + 1e-300
    at = np.broadcast_to(x[0], half.shape)
    pointers = []
    for low, high in zip(x[::every, None, :] - half, x[::every, None, :] + half, strict=True):
        at = np.minimum(np.maximum(at, low), high)
        pointers.append(at)
    found = (x[::every, None, :] - np.array(pointers)) / half
    return np.repeat(found, every, axis=0)[: len(x)].transpose(1, 0, 2)


def _periodic(trace: Trace, tone: Term) -> Iterator[_ShapeGroup]:
    """Shapes of a wave that was found: overtones, or switching on and off."""
    hz = tone.theta
    phase = 2.0 * np.pi * hz * (trace.t - trace.t[0])
    orders = [k for k in _HARMONICS if k * hz < _HIGHEST * trace.fs]
    if orders:
        signals = np.array([wave(k * phase) for k in orders for wave in (np.cos, np.sin)])
        yield _ShapeGroup("periodic", f"overtones of {hz:.3g} Hz", signals)
    if 2.0 * hz < _HIGHEST * trace.fs:
        waves, _, _ = np.linalg.svd(tone.beta.reshape(2, 3))
        for end, side in (("high", 1.0), ("low", -1.0)):
            wave = np.cos(phase - math.atan2(side * waves[1, 0], side * waves[0, 0]))  # of the axes together
            for part in _DUTY_CYCLES:
                on = np.asarray(wave > math.cos(math.pi * part), dtype=np.float64)
                yield _ShapeGroup("periodic", f"{hz:.3g} Hz, on for {part:.0%} about its {end}", on[None])
