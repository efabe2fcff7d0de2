"""Whether a trace can be diagnosed at all: length, life, frames, units, and a reference that goes with it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import InvalidInputError
from calib.gap.problem import Trace
from calib.recording import Recording, Sensor

Array = NDArray[np.float64]

SHORTEST_S = 5.0
FEWEST = 48
_MOVES = {Sensor.ACCEL: 0.3, Sensor.GYRO: 0.03, Sensor.MAG: 1.5}  # rms about the mean from which an ideal sensor moves
_TURNS_MUCH = 3.0
_ALIKE = 0.8  # correlation from which readings and reference are the same but for frame or unit
_UNLIKE = 0.3  # and below which they have nothing in common
_BETTER = 0.25  # share of the misfit that another frame must leave
_TIED = 1.1
_SIZE = 3.0  # ratio of sizes that no calibration error reaches
_FACTORS = {
    1000.0: "a thousand",
    100.0: "a hundred, as between gauss and uT",
    57.29578: "57.3, as between degrees and radians",
    10.0: "ten, as between mgauss and uT",
    9.80665: "9.8, as between g and m/s2",
    4.0: "four",
}
_AXES = "xyz"

Refusal = tuple[str, str, str]
"""Sensor, reason, need: as in :attr:`calib.gap.problem.Problem.not_testable`."""


@dataclass(frozen=True, eq=False)
class Checked:
    """The traces that can be diagnosed, and why the others cannot."""

    traces: tuple[Trace, ...]
    refused: tuple[Refusal, ...]


def checked(traces: tuple[Trace, ...]) -> Checked:
    """Each of `traces` that is long enough, alive, and in the frame and unit of its reference."""
    kept, refused = [], []
    for trace in traces:
        refusal = refusal_of(trace)
        if refusal is None:
            kept.append(trace)
        else:
            refused.append(refusal)
    return Checked(tuple(kept), tuple(dict.fromkeys(refused)))


def refusal_of(trace: Trace) -> Refusal | None:
    """Why `trace` cannot be diagnosed; None: it can."""
    name = f"{trace.sensor.value} of instance {trace.instances[0] + 1}"
    rows = trace.observed
    seconds = rows.sum() / trace.fs if len(trace.t) > 1 else 0.0
    if seconds < SHORTEST_S or rows.sum() < FEWEST:
        reason = f"{name} has {int(rows.sum())} samples over {seconds:.1f} s beside its reference"
        return trace.sensor.value, reason, f"at least {SHORTEST_S:.0f} s, better a minute"
    measured, ideal = trace.measured[rows], trace.ideal[rows]
    moves = ideal.std(axis=0) > _MOVES[trace.sensor]
    stuck = (np.ptp(measured, axis=0) == 0.0) & moves
    if stuck.any():
        axes = ", ".join(a for a, s in zip(_AXES, stuck, strict=True) if s)
        return (
            trace.sensor.value,
            f"{axes} of {name} reads one value throughout while the vehicle moves",
            "a live sensor",
        )
    turning = np.sort(ideal.std(axis=0))[1] > _TURNS_MUCH * _MOVES[trace.sensor]
    if trace.sensor == Sensor.GYRO or turning:  # an offset of the sensor is no frame
        measured, ideal = measured - measured.mean(axis=0), ideal - ideal.mean(axis=0)
    elif trace.sensor == Sensor.MAG:
        return None
    return _of_frame(trace, name, measured, ideal) if _tells(trace.sensor, ideal) else None


def _tells(sensor: Sensor, ideal: Array) -> bool:
    """Whether the vectors are long enough that a frame or a unit would show."""
    return bool(np.sqrt((ideal**2).sum(axis=1).mean()) > _MOVES[sensor])


def _of_frame(trace: Trace, name: str, measured: Array, ideal: Array) -> Refusal | None:
    cross = measured.T @ ideal
    turn = _signed_permutation(cross, measured, ideal)
    alike = _correlation(measured, ideal @ turn.T)
    if alike < _ALIKE:
        if alike >= _UNLIKE or trace.sensor != Sensor.GYRO:
            return None
        reason = f"{name} and its reference have nothing in common (correlation {alike:.2f})"
        return trace.sensor.value, reason, "a reference of the same movement, better than the sensor"
    size = float(np.sum(measured * (ideal @ turn.T)) / np.sum(ideal**2))
    if not 1.0 / _SIZE < size < _SIZE:
        reason = f"{name} is {size:.4g} times its reference: {_factor(size)}"
        return trace.sensor.value, reason, "the right unit: --unit-accel, --unit-gyro, --unit-mag, or a factor in --map"
    if not np.array_equal(turn, np.eye(3)):
        return trace.sensor.value, f"{name} is in another frame than its reference: {_in_words(turn)}", _FRAME_NEED
    return None


_FRAME_NEED = "the same frame in both: --body, --world or --map"


def _signed_permutation(cross: Array, measured: Array, ideal: Array) -> Array:
    """The exchange of axes and signs that fits best; the identity unless another leaves a quarter of its misfit.

    Scale and offset are left out of the comparison: among turns the sum ``m . P i`` decides. Of those that fit alike,
    the one that changes least.
    """
    best = float(np.sqrt((measured**2).sum() * (ideal**2).sum()))
    misfit = {key: max(best - float((cross * turn).sum()), 1e-12 * best) for key, turn in _TURNS.items()}
    least = min(misfit.values())
    if misfit[_IDENTITY] * _BETTER <= least:
        return _TURNS[_IDENTITY]
    tied = [key for key, value in misfit.items() if value <= _TIED * least + 1e-3 * best]
    return _TURNS[max(tied, key=lambda key: float(np.trace(_TURNS[key])))]


def _turns() -> dict[tuple[tuple[int, ...], tuple[int, ...]], Array]:
    found = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            found[order, signs] = turn
    return found


_TURNS = _turns()
_IDENTITY = ((0, 1, 2), (1, 1, 1))


def _in_words(turn: Array) -> str:
    """Which axis of the sensor reads which of the reference."""
    said = []
    for row in range(3):
        column = int(np.argmax(np.abs(turn[row])))
        sign = "-" if turn[row, column] < 0.0 else ""
        if column == row and sign:
            said.append(f"the sign of {_AXES[row]} is turned")
        elif column != row:
            said.append(f"{_AXES[row]} reads {sign}{_AXES[column]}")
    return ", ".join(said)


def _factor(size: float) -> str:
    ratio = max(size, 1.0 / size)
    factor = min(_FACTORS, key=lambda f: abs(np.log(ratio / f)))
    return f"units off by a factor of {_FACTORS[factor]}" if abs(np.log(ratio / factor)) < 0.2 else "units differ"


def _correlation(a: Array, b: Array) -> float:
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


def check_vehicles(real: Recording, others: tuple[Recording, ...]) -> None:
    """Recordings that are compared are of one kind of vehicle.

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
