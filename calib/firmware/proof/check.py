"""The check of one sensor's stream against every combination of the changes that act on it.

Samples of a turned compass that no combination explains are left out. A firmware reads a compass in a separate task and
streams the mean since its last reading. A late task on a turning vehicle averages over a longer arc, and the vector
becomes shorter. On a busy machine this was 6 mG in all three compasses of an ArduCopter, with a scatter of 0.5 mG.
Passing iron has the same effect. One such sample must not decide about a write. Each hypothesis pays :data:`PRICE` for
an omitted sample, so none can drop contradicting data more cheaply than another explains them. The cheapest hypothesis
decides which samples all of them leave out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.proof.discrepancy import (
    BeforeAfter,
    Undo,
    covariance,
    discrepancy,
    expected_of,
    true_magnitude,
)
from mavcal.calib.firmware.proof.evidence import IN_MOTION, StillMean, StreamEvidence
from mavcal.calib.firmware.proof.force import Force
from mavcal.calib.firmware.proof.hypotheses import Hypothesis, StreamJudgement, combinations_of, judge
from mavcal.calib.firmware.proof.known_drift import known_drift
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

ALL_APPLIED: Hypothesis = frozenset()
_UNOBSERVABLE: Final = 1e-3
"""Distance below which a check does not determine a direction; its standard deviation is then a thousand effects."""
TEMPERATURE_SLACK: Final = 0.3
"""degC beyond the range of a fit within which its drift still counts as known (streams carry about 1 Hz of it)."""
PRICE: Final = 5.0
"""Standard deviations by which a sample must deviate from the others to be left out; the square is its price."""
MOST: Final = 0.2
"""Share of the samples that may be left out."""


@dataclass(eq=False)
class Corrections:
    """Models and undoing of one sensor under hypotheses, each computed once."""

    force: Force
    about: Subject
    _models: dict[Hypothesis, TriadModel] = field(default_factory=dict)

    @property
    def every(self) -> Hypothesis:
        """The names of all changes."""
        return frozenset(change.name for change in self.force.changes)

    def model(self, refused: Hypothesis) -> TriadModel:
        """The correction in force if `refused` did not take effect."""
        if refused not in self._models:
            self._models[refused] = self.force.model(self.about, self.every - refused)
        return self._models[refused]

    def possible(self, refused: Hypothesis, readings: Sequence[StillMean]) -> bool:
        """Whether the firmware can hold this combination of values, and its correction of `readings` can be undone."""
        return not self.why_impossible(refused, readings)

    def why_impossible(self, refused: Hypothesis, readings: Sequence[StillMean]) -> str:
        """Reason against :meth:`possible`, in words; empty if it is possible."""
        if refused not in self._models:
            model = self.force.possible(self.about, self.every - refused)
            if model is None:
                return self.force.why_impossible(self.about, self.every - refused)
            self._models[refused] = model
        try:
            self.force.motor(self.about, self.every - refused, readings)
        except FirmwareError as error:  # a corrupt gain among the old values, or a drive that was not streamed
            return str(error)
        return ""

    def raw(self, refused: Hypothesis, readings: Sequence[StillMean]) -> Array:
        """Raw sensor readings (K, 3) if `refused` did not take effect."""
        streamed = np.array([r.mean for r in readings]).reshape(-1, 3)
        motor = self.force.motor(self.about, self.every - refused, readings)
        return self.model(refused).invert(streamed - motor, self.temperatures(refused, readings))

    def stream(self, refused: Hypothesis, raw: Array, readings: Sequence[StillMean]) -> Array:
        """Streamed readings (K, 3) of `raw` (K, 3) if `refused` did not take effect."""
        motor = self.force.motor(self.about, self.every - refused, readings)
        return self.model(refused).apply(raw, self.temperatures(refused, readings)) + motor

    def temperatures(self, refused: Hypothesis, readings: Sequence[StillMean]) -> Array | None:
        """Temperatures (K,) of the readings; None where the correction does not need them."""
        if self.model(refused).polynomial is None:
            return None
        return np.array([np.nan if r.temperature is None else r.temperature for r in readings])

    def readable(self, readings: tuple[StillMean, ...]) -> tuple[StillMean, ...]:
        """The `readings` whose correction can be undone: one by temperature needs the temperature."""
        ends = [self.force.possible(self.about, self.every - h) for h in (ALL_APPLIED, self.every)]
        thermal = any(m is not None and m.polynomial is not None for m in ends)
        return tuple(r for r in readings if r.temperature is not None or not thermal)


@dataclass(frozen=True, eq=False)
class StreamCheck:
    """Check of one sensor's stream against `names`, the changes that act on it."""

    corrections: Corrections
    capture: BeforeAfter
    names: tuple[str, ...]
    judgement: StreamJudgement
    equality: bool
    """Whether the captures before and after were compared; False: none before, or the vehicle was moved."""

    @property
    def unit(self) -> str:
        """Unit of the stream."""
        return {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s"}.get(self.capture.sensor, "uT")

    def without(self, name: str) -> Hypothesis:
        """Smallest set of changes, `name` among them, that may have failed together; empty: there is none."""
        return self.judgement.alone.get(name, ALL_APPLIED)

    def effect(self, name: str) -> float:
        """Largest error of the stream over the readings if `name` alone had not taken effect."""
        readings = (*self.capture.after, *self.capture.invariant)
        raw = self.corrections.raw(ALL_APPLIED, readings)
        with_it, without = (self.corrections.stream(h, raw, readings) for h in (ALL_APPLIED, self.without(name)))
        return float(np.linalg.norm(with_it - without, axis=1).max())

    def sd(self, name: str) -> float:
        """Standard deviation of the check along the effect of `name`, in the unit of the stream."""
        distance, effect = self.judgement.distance[name], self.effect(name)
        if effect > 0.0:
            return effect / max(distance, _UNOBSERVABLE)
        matrix = self.covariance(self.capture, equality=self.equality)
        return float(np.sqrt(np.diag(matrix).min()))

    def covariance(self, capture: BeforeAfter, *, equality: bool) -> Array:
        """Covariance of the discrepancy of `capture` with everything in force."""
        undo = self._undo(ALL_APPLIED)
        return covariance(capture, self.corrections.model(ALL_APPLIED), undo, equality=equality)

    def distance_in(self, name: str, readings: tuple[StillMean, ...]) -> float:
        """Standard deviations by which other readings would show `name`, comparing their lengths alone."""
        capture = dataclasses.replace(self.capture, before=None, raw_before=None, after=readings, invariant=readings)
        root = np.linalg.cholesky(self.covariance(capture, equality=False))
        shift = discrepancy(capture, self._undo(self.without(name)), equality=False)
        shift = shift - discrepancy(capture, self._undo(ALL_APPLIED), equality=False)
        return float(np.linalg.norm(np.linalg.solve(root, shift)))

    def _undo(self, refused: Hypothesis) -> Undo:
        return _undoing(self.corrections, refused)


def check_stream(
    about: Subject,
    names: tuple[str, ...],
    force: Force,
    pair: Pair | None,
    then: StreamEvidence,
    now: StreamEvidence,
    *,
    restarted: bool,
) -> StreamCheck | None:
    """Test the stream of `about` against every combination of `names`; None: there is none to test.

    `restarted`: whether the vehicle was restarted after `then` was taken.

    If no combination explains the captures before and after together, the vehicle was moved between them, and only
    the lengths of its vectors are left. A gyroscope at rest reads the same in any attitude, so it has no such excuse.
    """
    corrections = Corrections(force, about)
    if not corrections.possible(ALL_APPLIED, (*now.readings.get(about, ()), *now.moving.get(about, ()))):
        return None
    capture = _capture(corrections, pair, then, now, restarted=restarted)
    ways = [True] if capture.equality else []
    if capture.lengths and not (ways and about.sensor == Sensor.GYRO):
        ways.append(False)
    check = None
    for equality in ways:
        judgement = _judge(corrections, capture, names, equality=equality)
        check = StreamCheck(corrections, capture, names, judgement, equality)
        if judgement.explained:
            return check
    moved = ways == [True] and about.sensor != Sensor.GYRO
    return None if moved else check


def _capture(
    corrections: Corrections, pair: Pair | None, then: StreamEvidence, now: StreamEvidence, *, restarted: bool
) -> BeforeAfter:
    about = corrections.about
    in_force = corrections.model(ALL_APPLIED).polynomial
    drift = None if pair is None else pair.drift
    moves = known_drift(about.sensor, drift, in_force)
    known = moves.polynomial
    readings = within(known, corrections.readable(now.readings.get(about, ())))
    moving = within(known, corrections.readable(now.moving.get(about, ())))
    earlier = within(known, corrections.readable(then.readings.get(about, ())))
    comparable = bool(earlier) and corrections.possible(corrections.every, earlier[-1:])
    before = earlier[-1] if comparable else None
    expected = None
    if pair is not None and pair.absolute is not None:
        expected = expected_of(pair.at_rest, drift, moves, _magnitude(about.sensor, pair.absolute))
    return BeforeAfter(
        sensor=about.sensor,
        before=before,
        raw_before=None if before is None else corrections.raw(corrections.every, (before,))[0],
        after=readings,
        invariant=(*readings, *moving),
        expected=expected,
        drift=moves,
        restarted=restarted,
    )


def within(polynomial: ThermalPolynomial | None, readings: tuple[StillMean, ...]) -> tuple[StillMean, ...]:
    """`readings` at temperatures where the drift is known: beyond these the firmware clamps it.

    Readings without a temperature are kept, with their uncertainty in the covariance.
    """
    if polynomial is None:
        return readings
    low, high = polynomial.t_min - TEMPERATURE_SLACK, polynomial.t_max + TEMPERATURE_SLACK
    return tuple(r for r in readings if r.temperature is None or low <= r.temperature <= high)


def out_of_range(about: Subject, force: Force, pair: Pair | None, now: StreamEvidence) -> str:
    """A sentence if every reading of `about` was taken outside the range of its drift; else empty.

    Waiting there proves nothing, so the range is said in which it will be provable.
    """
    in_force = Corrections(force, about).model(ALL_APPLIED).polynomial
    known = known_drift(about.sensor, None if pair is None else pair.drift, in_force).polynomial
    taken = [r for r in now.readings.get(about, ()) if r.temperature is not None]
    if known is None or not taken or within(known, tuple(taken)):
        return ""
    heat = float(taken[-1].temperature or 0.0)
    side = f"below {known.t_max:.0f}" if heat > known.t_max else f"above {known.t_min:.0f}"
    return (
        f"{about} is at {heat:.1f} degC and its drift is known from {known.t_min:.0f} to {known.t_max:.0f} degC: "
        f"it will be provable {side} degC"
    )


def _magnitude(sensor: Sensor, fit: FitResult | None) -> float | None:
    """Length of the true vector; a magnetometer's is in the quality of its fit, if the field was known."""
    if sensor != Sensor.MAG or fit is None:
        return true_magnitude(sensor)
    radius, ratio = fit.quality.get("radius"), fit.quality.get("field_ratio")
    return None if not radius or not ratio else float(radius) / float(ratio)


def _judge(
    corrections: Corrections, capture: BeforeAfter, names: tuple[str, ...], *, equality: bool
) -> StreamJudgement:
    whole = corrections.model(ALL_APPLIED)
    matrix = covariance(capture, whole, _undoing(corrections, ALL_APPLIED), equality=equality)

    readings = (*capture.after, *capture.invariant)
    vectors = {
        refused: discrepancy(capture, _undoing(corrections, refused), equality=equality)
        for refused in combinations_of(names)
        if corrections.possible(refused, readings)
    }
    kept = np.ones(len(matrix), dtype=bool)
    turned = [k for k, reading in enumerate(capture.invariant) if reading.rest == IN_MOTION]
    if turned and capture.sensor != Sensor.GYRO and capture.expected is not None:
        candidates = ~kept
        candidates[np.array(turned) + len(matrix) - len(capture.invariant)] = True
        kept = ~outliers(np.array(list(vectors.values())), matrix, candidates)
    whitening = np.linalg.inv(np.linalg.cholesky(matrix[np.ix_(kept, kept)]))

    def whitened(refused: Hypothesis) -> Array | None:
        return np.asarray(whitening @ vectors[refused][kept]) if refused in vectors else None

    return judge(names, whitened)


def _undoing(corrections: Corrections, refused: Hypothesis) -> Undo:
    return lambda readings: corrections.raw(refused, readings)


def strongest(checks: Mapping[Subject, StreamCheck], name: str) -> StreamCheck | None:
    """The most significant check of `name`: a contradiction first, then the largest distance."""
    about = [c for c in checks.values() if name in c.names]
    return max(about, key=lambda c: _weight(c, name), default=None)


def _weight(check: StreamCheck, name: str) -> tuple[int, float]:
    order = ("not_observable", "consistent", "proved", "contradicted")
    return order.index(check.judgement.verdicts[name].value), check.judgement.distance[name]


def outliers(vectors: Array, covariance: Array, candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the rows (n,) to leave out.

    Parameters
    ----------
    vectors : shape (H, n)
        The discrepancy under each hypothesis.
    covariance : shape (n, n)
        Of the discrepancy under the true one.
    candidates : shape (n,)
        The rows that may be spoilt.
    """
    precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    most = int(MOST * candidates.sum())
    best, found = float(np.inf), np.zeros(len(candidates), dtype=np.bool_)
    for vector in vectors:
        cost, out = _cheapest(vector, precision, candidates, most)
        if cost < best:
            best, found = cost, out
    return found


def _cheapest(
    vector: Array, precision: Array, candidates: NDArray[np.bool_], most: int
) -> tuple[float, NDArray[np.bool_]]:
    """Sum of squares with its price when the worst rows are left out one after the other, and which they are."""
    precision, out = precision.copy(), np.zeros(len(vector), dtype=bool)
    pull = precision @ vector
    cost = float(vector @ pull)
    for _ in range(most):
        # squared distance of each row from its prediction by the other remaining rows
        squares = np.where(candidates & ~out, pull**2 / np.maximum(np.diag(precision), np.finfo(float).tiny), 0.0)
        worst = int(squares.argmax())
        if squares[worst] <= PRICE**2:
            break
        cost += PRICE**2 - float(squares[worst])
        column = precision[:, worst] / precision[worst, worst]
        pull = pull - column * pull[worst]
        precision = precision - np.outer(column, precision[worst])
        out[worst] = True
    return cost, out
