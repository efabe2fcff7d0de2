"""Checks of a trace: length, liveness, frame, unit, and a matching reference."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import hann

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.align import (
    ANOTHER_UNIT,
    UNCORRELATED,
    best_axis_exchange,
    correlation,
    uncorrelated_axes,
)
from mavcal.calib.gap.reference.signals import HOLE
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

SHORTEST_S = 5.0
"""Least time of samples with a reference, s. Chosen, not measured: a few movements of a vehicle."""
FEWEST = 48
"""Least number of samples with a reference. Chosen, not measured: five seconds of a compass at 10 Hz."""
_PIECE_S, _COVERED = 1.0, 0.5
"""Mean length of the pieces, s, and the share of the time that they cover. A channel below both is fragmented. Chosen,
not measured: movements last a second, and held poses with pauses between them last longer."""
MOVES = {Sensor.ACCEL: 0.3, Sensor.GYRO: 0.03, Sensor.MAG: 1.5}
"""Rms about the mean above which an ideal reading counts as moving, m/s2, rad/s and uT. Chosen, not measured: 3 % of
gravity and of a field of 50 uT, and 1.7 deg/s."""
_TURNS_MUCH = 3.0
"""Multiple of `MOVES` above which an accelerometer's movement about its mean shows its frame. Chosen, not measured: a
tenth of gravity."""
_SAME = 0.8
"""Correlation above which readings and reference agree except for frame or unit. Chosen, not measured: two thirds of
the power are common then."""
_SLIGHT = 0.02
"""Relative misfit below which no other frame is sought. Source: `1 - cos(11 deg)`; the angle is chosen, not measured:
mountings are off by less."""
_FAR_OFF = 6.0
"""Ratio of field strengths beyond any effect of iron. Chosen, not measured: twice the ratio of the Earth's strongest
field to its weakest."""
_ONE_VALUE = 1e-12
"""Range below which readings are constant. Source: rounding, 1e-16 of the readings, with a margin."""
_DIGITS = 1e-12
"""Rounding error of the computer relative to the readings. Source: 1e-16 for each operation, with a margin."""
_POSSIBLE = 1e7
"""Reading that no sensor has in any unit. Chosen, not measured: 200 times the Earth's field in nanotesla."""
_WILD = 50.0
"""Multiple of the reference's largest reading above which a single reading is damage. Chosen, not measured: a mistaken
unit shows in all readings."""
_SELDOM = 0.01
"""Fraction of readings up to which they count as single. Chosen, not measured: one in a hundred."""
_SLOWEST_S = 0.7
"""Sample interval, s, above which time is not in seconds, or no movement is resolved. Chosen, not measured: logs have 5
samples a second and more, with a margin."""
_NOISIER = 10.0
"""Ratio of noise powers above which the reference is worse than the sensor. Chosen, not measured: three times the
amplitude."""
# Ratios of sizes that mistaken units make, and how they are said.
_FACTORS = {
    Sensor.ACCEL: {1000.0 / 9.80665: "102, as between mg and m/s2", 9.80665: "9.8, as between g and m/s2"},
    Sensor.GYRO: {57.29578: "57.3, as between degrees and radians"},
    Sensor.MAG: {100.0: "a hundred, as between gauss and uT", 10.0: "ten, as between mgauss and uT"},
}
"""Ratios of magnitudes by mistaken units, and their wording. Source: definitions of the units."""
_ANY_FACTOR = {1e6: "a million", 1000.0: "a thousand", 4.0: "four"}
"""Ratios by which any sensor may be wrong, and their wording. Source: prefixes of the SI. Four is chosen, not measured:
two steps of a sensor's range."""
_WEAKEST_UT, _STRONGEST_UT = 10.0, 130.0
"""Weakest and strongest field that is the Earth's, uT. Source: it has 22 to 67 uT; a factor of two is left for
buildings that bend it."""
_AXES = "xyz"

Refusal = tuple[str, str, str]
"""Sensor, reason, need: as in :attr:`calib.gap.problem.Problem.not_testable`."""


@dataclass(frozen=True, eq=False)
class Checked:
    """The usable traces, and why the others are refused."""

    traces: tuple[Trace, ...]
    refused: tuple[Refusal, ...]


def checked(traces: tuple[Trace, ...]) -> Checked:
    """The traces that are long enough, live, and in the frame and unit of their reference."""
    accepted, refused = [], []
    for trace in traces:
        refusal = refusal_of(trace)
        if refusal is None:
            accepted.append(trace)
        else:
            refused.append(refusal)
    return Checked(tuple(accepted), tuple(dict.fromkeys(refused)))


def fragmented(channel: Channel) -> Refusal | None:
    """Why a channel with more holes than samples is refused; None if it has fewer.

    Between its pieces neither the movement nor the state of the filters is known.
    """
    t = np.unique(channel.t)
    if len(t) < FEWEST:
        return None
    step = np.diff(t)
    usual = float(np.median(step))
    pieces = 1 + int((step > HOLE * usual).sum())
    length, covered = len(t) * usual / pieces, len(t) * usual / float(t[-1] - t[0])
    if length > _PIECE_S or covered > _COVERED:
        return None
    name = f"{channel.sensor.value} of instance {channel.instance + 1}"
    reason = f"{name} is in {pieces} pieces of {length:.2f} s, which cover {100.0 * covered:.0f} % of its time"
    return channel.sensor.value, reason, "a log without holes: fewer messages, or a faster card"


def refusal_of(trace: Trace) -> Refusal | None:
    """Why `trace` cannot be diagnosed; None if it can."""
    name = f"{trace.sensor.value} of instance {trace.instances[0] + 1}"
    rows = trace.observed
    seconds = rows.sum() / trace.fs if len(trace.t) > 1 else 0.0
    if seconds < SHORTEST_S or rows.sum() < FEWEST:
        reason = f"{name} has {int(rows.sum())} samples over {seconds:.1f} s beside its reference"
        return trace.sensor.value, reason, f"at least {SHORTEST_S:.0f} s, better a minute"
    measured, ideal = trace.measured[rows], trace.ideal[rows]
    return (
        _impossible_reading(trace, name, measured, ideal)
        or _uncorrelated(trace, name)
        or (_wrong_field(name, measured, ideal) if trace.sensor == Sensor.MAG else None)
        or _constant_axis(trace, name, measured, ideal)
        or _noise_free_difference(trace, name, measured, ideal)
        or _in_another_frame(trace, name, measured, ideal)
        or _worse_reference(trace, name, measured, ideal)
    )


def _impossible_reading(trace: Trace, name: str, measured: Array, ideal: Array) -> Refusal | None:
    for whose, values in ((name, measured), (f"the reference of {name}", ideal)):
        row, axis = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
        if abs(values[row, axis]) > _POSSIBLE:
            at = float(trace.t[trace.observed][row])
            reason = f"{whose} reads {values[row, axis]:.3g} {trace.unit} on {_AXES[axis]} at {at:.3f} s"
            return trace.sensor.value, reason, "damaged rows left out, or the right unit"
    size, expected = np.abs(measured).max(axis=1), max(float(np.abs(ideal).max()), MOVES[trace.sensor])
    wild = size > _WILD * max(expected, float(np.median(size)))
    if not 0.0 < wild.mean() < _SELDOM:
        return None
    at = float(trace.t[trace.observed][np.argmax(size)])
    reason = f"{name} reads {size.max():.3g} {trace.unit} at {at:.3f} s, and {int(wild.sum())} such rows in all"
    return trace.sensor.value, reason, "damaged rows left out"


def _constant_axis(trace: Trace, name: str, measured: Array, ideal: Array) -> Refusal | None:
    """Refusal for an axis that never changes; a live sensor has noise even at rest."""
    stuck = np.ptp(measured, axis=0) < _ONE_VALUE
    if stuck.any():
        moves = (ideal.std(axis=0) > MOVES[trace.sensor]) & stuck
        when = " while the vehicle moves" if moves.any() else ": a live sensor has noise"
        named = _axes(moves if moves.any() else stuck)
        return trace.sensor.value, f"{named} of {name} reads one value throughout{when}", "a live sensor"
    still = (np.ptp(ideal, axis=0) == 0.0) & (measured.std(axis=0) > MOVES[trace.sensor])
    if still.any() and trace.against is None:
        reason = f"the reference of {name} has one value throughout on {_axes(still)} while the sensor moves"
        return trace.sensor.value, reason, "a reference of the same movement: check its columns, or leave them out"
    return None


def _uncorrelated(trace: Trace, name: str) -> Refusal | None:
    """Refusal for a sensor that does not follow its reference: one of them is dead, or from another movement."""
    if trace.against is not None or not trace.rate_known:
        return None
    axes = uncorrelated_axes(trace, MOVES[trace.sensor])
    if not axes.any() or (np.ptp(trace.measured[trace.observed], axis=0)[axes] < _ONE_VALUE).all():
        return None
    reason = f"{name} does not follow its reference on {_axes(axes)}: they have nothing in common"
    return trace.sensor.value, reason, "a live sensor, and a reference of the same movement"


def _noise_free_difference(trace: Trace, name: str, measured: Array, ideal: Array) -> Refusal | None:
    """Refusal for a noise-free difference: the reference was computed from the sensor, or both by one formula.

    Two instances of a simulator may be equal to the last digit; their difference is then known exactly.
    """
    if trace.against is not None:
        return None
    difference = measured - ideal
    same = np.ptp(difference, axis=0) <= _DIGITS * np.abs(measured).max()
    if not same.any():
        return None
    by = ", ".join(f"{value:.6g}" for value in difference[0])
    reason = f"{name} and its reference differ by {by} {trace.unit} throughout on {_axes(same)}, without any noise"
    return trace.sensor.value, reason, "a reference that was not made from the sensor, and a sensor with noise"


def _axes(chosen: NDArray[np.bool_]) -> str:
    return ", ".join(a for a, s in zip(_AXES, chosen, strict=True) if s)


def _in_another_frame(trace: Trace, name: str, measured: Array, ideal: Array) -> Refusal | None:
    spread = _spreads(ideal)[1]
    turning = spread > (1.0 if trace.sensor == Sensor.MAG else _TURNS_MUCH) * MOVES[trace.sensor]
    if trace.sensor == Sensor.GYRO or turning:  # an offset of the sensor is no frame
        measured, ideal = measured - measured.mean(axis=0), ideal - ideal.mean(axis=0)
        slight = _SLIGHT
    elif trace.sensor == Sensor.MAG:
        return None
    else:
        slight = 0.0  # gravity is most of it, whatever x and y do
    return _wrong_frame_or_unit(trace, name, measured, ideal, slight) if _is_large_enough(trace.sensor, ideal) else None


def _spreads(values: Array) -> Array:
    """Standard deviations (3,) along the principal directions, largest first."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(values.T))[::-1], 0.0)))


def _wrong_field(name: str, measured: Array, ideal: Array) -> Refusal | None:
    """Refusal for a magnetometer in a wrong unit, by the field strength, which iron changes by a small factor only."""
    read, true = (float(np.median(np.linalg.norm(v, axis=1))) for v in (measured, ideal))
    if true == 0.0 or read == 0.0:
        return None  # nothing was read: that is said elsewhere
    if not _WEAKEST_UT < true < _STRONGEST_UT:
        reason = f"the field at {name} would be {true:.3g} uT, and the Earth's is 22 to 67"
        return Sensor.MAG.value, reason, "uT: --unit-mag, or a factor in --map"
    size = read / true
    if 1.0 / _FAR_OFF < size < _FAR_OFF:
        return None
    return (
        Sensor.MAG.value,
        f"{name} is {size:.4g} times its reference: {_factor(size, Sensor.MAG)}",
        _unit_need(Sensor.MAG),
    )


def _worse_reference(trace: Trace, name: str, measured: Array, ideal: Array) -> Refusal | None:
    """Refusal for a reference with far more white noise than the sensor."""
    if trace.against is not None:
        return None
    length = min(256, len(measured) // 6)
    # Medians over pieces and frequencies exclude edges, single events and lines.
    power = [_median_power(v, length)[2:-1] for v in (measured, ideal, measured - ideal)]
    half = len(power[0]) // 2
    own, of_reference, left = (np.median(p[half:], axis=0) for p in power)
    slow = np.median(power[2][: half // 2], axis=0)
    own = np.maximum(own, 2.0 * trace.quantum**2 / 12.0)  # one-sided, at a sampling rate of one
    worse = (of_reference > _NOISIER * own) & (slow > 0.5 * of_reference) & (left > 0.5 * of_reference)
    if not worse.any():
        return None
    times = float(np.sqrt((of_reference[worse] / np.maximum(own[worse], 1e-300)).max()))
    reason = f"the reference of {name} has {times:.3g} times the noise of the sensor on {_axes(worse)}"
    return trace.sensor.value, reason, "a reference that is better than the sensor"


def _median_power(values: Array, length: int) -> Array:
    """One-sided power of `values` (N, 3) at a sampling rate of one: the median over detrended pieces of `length`.

    Welch's periodogram (half overlapping, Hann) of all pieces at once; the median of that many exponential variables of
    mean one is the alternating harmonic sum.
    """
    pieces = np.lib.stride_tricks.sliding_window_view(values, length, axis=0)[:: length - length // 2]
    line = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), 2))[0]
    window = hann(length, sym=False)
    spectra = np.fft.rfft((pieces - pieces @ line @ line.T) * window, axis=-1)
    even = 2.0 * np.arange(1, (len(pieces) - 1) // 2 + 1)
    middle = 1.0 + float((1.0 / (even + 1.0) - 1.0 / even).sum())
    return np.asarray(2.0 * np.median(np.abs(spectra) ** 2, axis=0).T / (middle * (window @ window)))


def _is_large_enough(sensor: Sensor, ideal: Array) -> bool:
    """Whether the vectors are large enough to show a frame or a unit."""
    return bool(np.sqrt((ideal**2).sum(axis=1).mean()) > MOVES[sensor])


def _wrong_frame_or_unit(trace: Trace, name: str, measured: Array, ideal: Array, slight: float) -> Refusal | None:
    turn = best_axis_exchange(measured, ideal, slight)
    similarity = correlation(measured, ideal @ turn.T)
    if similarity < _SAME:
        if similarity >= UNCORRELATED or trace.sensor != Sensor.GYRO:
            return None
        reason = f"{name} and its reference have nothing in common (correlation {similarity:.2f})"
        return trace.sensor.value, reason, "a reference of the same movement, better than the sensor"
    size = float(np.sum(measured * (ideal @ turn.T)) / np.sum(ideal**2))
    if not 1.0 / ANOTHER_UNIT < size < ANOTHER_UNIT:
        reason = f"{name} is {size:.4g} times its reference: {_factor(size, trace.sensor)}"
        return trace.sensor.value, reason, _unit_need(trace.sensor)
    if not np.array_equal(turn, np.eye(3)):
        return (
            trace.sensor.value,
            f"{name} is in another frame than its reference: {_exchange_in_words(turn)}",
            _FRAME_NEED,
        )
    return None


_FRAME_NEED = "the same frame in both: --body, --world or --map"


def _unit_need(sensor: Sensor) -> str:
    return f"the right unit: --unit-{sensor.value}, or a factor in --map"


def _exchange_in_words(turn: Array) -> str:
    """Description of an exchange of axes."""
    said = []
    for row in range(3):
        column = int(np.argmax(np.abs(turn[row])))
        sign = "-" if turn[row, column] < 0.0 else ""
        if column == row and sign:
            said.append(f"the sign of {_AXES[row]} is turned")
        elif column != row:
            said.append(f"{_AXES[row]} reads {sign}{_AXES[column]}")
    return ", ".join(said)


def _factor(size: float, sensor: Sensor) -> str:
    ratio = max(size, 1.0 / max(size, 1e-300))
    known = _FACTORS[sensor] | _ANY_FACTOR
    factor = min(known, key=lambda f: abs(np.log(ratio / f)))
    return f"units off by a factor of {known[factor]}" if abs(np.log(ratio / factor)) < 0.2 else "units differ"


def check_vehicles(real: Recording, others: tuple[Recording, ...]) -> None:
    """Check that all recordings are of one kind of vehicle.

    Raises
    ------
    InvalidInputError
        If two of them say that they are of different types.
    """
    kind = real.identity.vehicle_type
    for other in others:
        if kind and other.identity.vehicle_type and other.identity.vehicle_type != kind:
            raise InvalidInputError(
                f"{other.source or 'the other recording'} is of another kind of vehicle (MAV_TYPE "
                f"{other.identity.vehicle_type}) than {real.source or 'the real one'} ({kind}): give logs of one"
            )


def check_times(recordings: Iterable[Recording]) -> None:
    """Check that time is in seconds, with samples fast enough for a movement.

    Raises
    ------
    InvalidInputError
        If the fastest sensor of one of them is sampled less than about once a second, or its time stands still.
    """
    for recording in recordings:
        name = recording.source or "a recording"
        times = [np.unique(c.t) for c in recording.channels if c.sensor in MOVES and len(c) >= FEWEST]
        if times and max(map(len, times)) < 4:
            raise InvalidInputError(f"{name} has one time for all samples: fill column t, or leave it out, with --rate")
        steps = [float(np.median(np.diff(t))) for t in times if len(t) > 3]
        if not steps or min(steps) < _SLOWEST_S:
            continue
        if counted := next((e.text for e in recording.events if e.kind == NO_TIME), None):
            raise InvalidInputError(f"{name}: {counted}")
        unit = next((u for u in _TIMES if min(steps) > _TIMES[u][0]), "")
        hint = f": t looks like {unit}, and is in seconds: --map t=t*{_TIMES[unit][1]}" if unit else ""
        raise InvalidInputError(f"{name} has a sample every {min(steps):.4g} s{hint or ': too slow for any movement'}")


_TIMES = {"nanoseconds": (2e5, "1e-9"), "microseconds": (200.0, "1e-6"), "milliseconds": (_SLOWEST_S, "1e-3")}
"""Median steps above which time is taken to be in that unit. Source: definitions of the units, and 5 to 5000 samples
per second."""
