"""Drift of accelerometers and gyros with temperature, from a still vehicle that warms up or cools down.

Only still spans count. If the vehicle was moved between two of them, gravity on the accelerometer differs, and each
span has its own offset (METHODS 3.4). The shape of the drift is common.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mavcal.calib.firmware.limits import THERMAL_SPAN_MIN
from mavcal.calib.firmware.storable import DRIFT
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure
from mavcal.calib.procedures.drift_fit import DriftPool, fit_drift
from mavcal.calib.procedures.motion import Disturbance, StillnessVerdict
from mavcal.calib.procedures.pool import Tail
from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Sensor

_PARTS = (0.0, 0.25, 0.5)
"""Fractions of the last minute from which extrapolations start."""
_SPREAD = 0.25
"""Largest difference of the extrapolations, relative to the remaining change."""
_NEAR = 1.0
"""Difference, degC, that is always allowed."""
SPEC = ProcedureSpec(
    kind="thermal",
    title="Drift of accelerometers and gyros with temperature",
    sensors=(Sensor.ACCEL, Sensor.GYRO, Sensor.TEMPERATURE),
    helpful=(),
    options=(
        Option("span", float, 25.0, "range of temperature to cover, every unit", "degC", 10.0, 100.0),
        Option(
            "extend",
            bool,
            default=True,
            help="goes on past the span until the temperature settles, or the operator ends it",
        ),
        Option("settled", float, 0.2, "rate below which the temperature counts as settled", "degC/min", 0.01, 5.0),
        Option(
            "accel_residual",
            float,
            0.02,
            "standard deviation of the accelerometers' drift curve to reach",
            "m/s2",
            1e-3,
            0.2,
        ),
        Option(
            "gyro_residual", float, 0.05, "standard deviation of the gyros' drift curve to reach", "deg/s", 2e-3, 0.5
        ),
        Option("patience", float, 600.0, "gives up after this time without a change of temperature", "s", 30.0, 7200.0),
    ),
    needs="a cold vehicle lying still while it warms up by its own heat (or a warm one that cools down)",
    ends_on="a settled temperature, or `finish` once the range is wide enough (25 degC). "
    "The drift curves are then known to 0.02 m/s2 and 0.05 deg/s",
    autopilots=DRIFT,
    duration_s=900.0,
)

GUARD_TICKS = 4
"""Ticks before a detected movement that do not count: one second."""

STILL_COLD = 1.0
"""Range, degC, below which the temperature counts as constant."""

FIT_AGAIN = 0.1
"""Time until the next fit after one that missed the goal, as a fraction of the elapsed time."""

SETTLED_OVER = 60.0
"""Time, s, over which the rate of temperature is measured."""


@dataclass(frozen=True)
class WarmUpEnd:
    """Forecast of a temperature."""

    left: float
    """Seconds until its rate falls below the bound."""
    at: float
    """Temperature at its end, degC."""
    spread: float
    """Largest difference from it of extrapolations from parts of the last minute, degC."""


class Warmth:
    """Follows every unit's temperature."""

    def __init__(self, over: float) -> None:
        self._over = over
        self._all = _Range()
        self._kept = _Range()
        self._history: deque[tuple[float, float]] = deque()
        self.now: dict[int, float] = {}
        """Latest temperature of every unit, degC."""

    def update(self, frame: TickChannels, units: tuple[int, ...]) -> None:
        """Take a tick; only `units` count."""
        for unit in set(self.now) - set(units):
            del self.now[unit]
        self._all.add(frame, units)
        for unit in units:
            channel = frame.get((Sensor.TEMPERATURE, unit))
            if channel is not None:
                self.now[unit] = float(channel.values[-1, 0])
                if unit == min(self.now):
                    self._history.append((float(channel.t[-1]), self.now[unit]))
        while len(self._history) > 2 and self._history[-1][0] - self._history[1][0] >= self._over:
            self._history.popleft()

    def keep(self, frame: TickChannels) -> None:
        """The samples of `frame` are kept for the fit."""
        self._kept.add(frame, tuple(self.now))

    @property
    def moved(self) -> float:
        """Smallest temperature range of any unit, degC."""
        return self._all.least(self.now)

    @property
    def span(self) -> float:
        """Smallest kept temperature range of any unit, degC."""
        return self._kept.least(self.now)

    @property
    def rate(self) -> float:
        """Rate of the first unit over the last minute, degC/s; 0 while unknown."""
        if len(self._history) < 2:
            return 0.0
        (t0, first), (t1, last) = self._history[0], self._history[-1]
        return (last - first) / (t1 - t0) if t1 > t0 else 0.0

    def settles(self, bound: float) -> WarmUpEnd | None:
        """When the rate falls below `bound` (degC per minute), and where the first unit's temperature ends.

        Extrapolated from the fall of the rate within the last minute, as for a body that approaches ambient
        temperature. Later parts of that minute give further estimates. None while the rate does not fall or the
        estimates disagree: a curve that has hardly bent does not determine its end.
        """
        if len(self._history) < 3 or self._history[-1][0] - self._history[0][0] < 0.5 * self._over:
            return None
        begin, (end, last) = self._history[0][0], self._history[-1]
        found = []
        for share in _PARTS:
            start = begin + share * (end - begin)
            rate = _extrapolated([point for point in self._history if point[0] >= start])
            if rate is None:
                return None
            found.append(rate)
        constant, at = found[0]
        spread = max(abs(other - at) for _, other in found[1:])
        if spread > max(_SPREAD * abs(at - last), _NEAR):
            return None
        left = constant * math.log(max(abs(self.rate) * 60.0 / bound, 1.0))
        return WarmUpEnd(left, at, spread)

    def is_steady(self, bound: float) -> bool:
        """Whether the rate over a whole minute lies below `bound` (degC per minute)."""
        if len(self._history) < 2 or self._history[-1][0] - self._history[0][0] < self._over:
            return False
        return abs(self.rate) * 60.0 < bound


def _extrapolated(history: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Time constant (s) and end (degC) of the exponential through the first, the middle and the last point."""
    if len(history) < 3:
        return None
    middle = 0.5 * (history[0][0] + history[-1][0])
    (t0, first), (t2, last) = history[0], history[-1]
    t1, between = min(history, key=lambda point: abs(point[0] - middle))
    if not t0 < t1 < t2:
        return None
    early, late = (between - first) / (t1 - t0), (last - between) / (t2 - t1)
    if early * late <= 0.0 or abs(late) >= 0.98 * abs(early):
        return None
    constant = 0.5 * (t2 - t0) / math.log(early / late)
    now = late * math.exp(-0.5 * (t2 - t1) / constant)
    return constant, last + now * constant


class _Range:
    """Lowest and highest temperature of every unit."""

    def __init__(self) -> None:
        self._ends: dict[int, tuple[float, float]] = {}

    def add(self, frame: TickChannels, units: Iterable[int]) -> None:
        for unit in units:
            channel = frame.get((Sensor.TEMPERATURE, unit))
            if channel is not None:
                low, high = float(channel.values.min()), float(channel.values.max())
                known = self._ends.get(unit, (low, high))
                self._ends[unit] = (min(known[0], low), max(known[1], high))

    def least(self, units: Iterable[int]) -> float:
        ends = [self._ends.get(unit, (0.0, 0.0)) for unit in units]
        return min((high - low for low, high in ends), default=0.0)


class ThermalProcedure(TickedProcedure):
    """Collects still spans while the temperature moves, then fits a cubic to every unit."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._warmth = Warmth(SETTLED_OVER)
        self._pool = DriftPool()
        self._tail = Tail(GUARD_TICKS)
        self._spans = 0
        self._resting = False
        self._still = 0.0
        self._why = ""
        self._what = Disturbance.NONE
        self._missed = ""
        self._next_fit = -math.inf

    def _on_start(self, present: set[Instance]) -> None:
        for sensor in (Sensor.ACCEL, Sensor.GYRO):
            for instance in self.present(sensor):
                if (Sensor.TEMPERATURE, instance) not in present:
                    self._leave_out((sensor, instance), "the vehicle sends no temperature of it")
        if not self._units():
            self._give_up(
                "the vehicle sends no temperature with the samples of any inertial unit",
                "a drift with temperature cannot be measured on this vehicle",
            )
        self._ask(still=True)

    def _units(self) -> tuple[int, ...]:
        """Instances that have a thermometer and at least one sensor."""
        moving = {*self.present(Sensor.ACCEL), *self.present(Sensor.GYRO)}
        return tuple(i for i in self.present(Sensor.TEMPERATURE) if i in moving)

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        self._warmth.update(frame, self._units())
        verdict = self._watch.update(frame)
        if not verdict.still:
            self._on_movement(verdict)
        elif verdict.counted:
            self._keep(start, end, frame)
        self._ask(still=verdict.still)
        self._judge()
        if self.outcome is None:
            self._update_prompt(verdict)

    def _on_movement(self, verdict: StillnessVerdict) -> None:
        self._why, self._what = verdict.why, verdict.what
        self._tail = Tail(GUARD_TICKS)
        self._resting = False

    def _keep(self, start: float, end: float, frame: TickChannels) -> None:
        kept = self._tail.push(frame)
        if kept is None:
            return
        if not self._resting:
            self._resting = True
            self._spans += 1
        self._pool.add(kept, self._spans)
        self._warmth.keep(kept)
        self._still += end - start

    # -- judging ---------------------------------------------------------------------------------------------------

    def _judge(self) -> None:
        span, is_steady = self._warmth.span, self._warmth.is_steady(self.options["settled"])
        covered = span >= self.options["span"] and (is_steady or not self.options["extend"])
        if covered or (is_steady and span >= THERMAL_SPAN_MIN):
            if self.time >= self._next_fit:
                self._next_fit = self.time + max(5.0, FIT_AGAIN * self.elapsed)
                why = "the temperature has settled" if is_steady else "the requested span is covered"
                self._try(why, last=is_steady)
        elif is_steady and self._warmth.moved >= THERMAL_SPAN_MIN:
            self._give_up(
                f"the temperature moved by {self._warmth.moved:.1f} degC and settled, but the vehicle was still for "
                f"{span:.1f} degC of it only: {self._why}",
                "put the vehicle on a firm surface and leave it alone, then start again",
            )
        elif is_steady and self._warmth.moved >= STILL_COLD:
            self._give_up(
                f"the temperature settled after {self._warmth.moved:.1f} degC; "
                f"a drift needs {THERMAL_SPAN_MIN:.0f} degC",
                "cool the vehicle down first (a freezer bag, a cold room) and start again while it is cold",
            )
        elif self._warmth.moved < STILL_COLD and self.elapsed >= self.options["patience"]:
            self._give_up(
                f"the temperature never moved: {self._warmth.moved:.2f} degC in {self.elapsed:.0f} s",
                "start with a cold vehicle, or warm it; if the temperature reads a constant, the sensor has none",
            )

    def _try(self, because: str, *, last: bool) -> None:
        """Fit; finish if the curves are known well enough, or if these are the last samples."""
        fits = self._fit()
        self._missed = self._shortfall(fits)
        if not self._missed:
            self._end(fits, f"{because} ({self._warmth.span:.1f} degC)")
        elif last:
            self._give_up(
                f"{because}, but {self._missed}", "let it rest undisturbed and change its temperature more slowly"
            )

    def _fit(self) -> tuple[FitResult, ...]:
        return tuple(
            fit_drift(self._pool, sensor, instance, relative=self.context.relative)
            for sensor in (Sensor.ACCEL, Sensor.GYRO)
            for instance in self._units()
            if (sensor, instance) in self._pool and (Sensor.TEMPERATURE, instance) in self._pool
        )

    def _shortfall(self, fits: tuple[FitResult, ...]) -> str:
        """Reason why the fits miss the goal; empty if they reach it."""
        if not fits:
            return f"the vehicle was still for {self._still:.0f} s only ({self._why})"
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        if not usable:
            return f"{label(fits[0].sensor, fits[0].instance)}: {fits[0].message}"
        goals = {Sensor.ACCEL: self.options["accel_residual"], Sensor.GYRO: math.radians(self.options["gyro_residual"])}
        for fit in usable:
            known = [s for s in fit.quality["drift_sd"] if s is not None]
            reached = max(known, default=0.0)
            if reached > goals[fit.sensor]:
                unit = "m/s2" if fit.sensor == Sensor.ACCEL else "rad/s"
                return f"the drift of {label(fit.sensor, fit.instance)} is known to {reached:.2g} {unit} only"
        return ""

    def _end(self, fits: tuple[FitResult, ...], because: str) -> None:
        self._dropped_rows()
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        if not usable:
            reason = fits[0].message if fits else self._shortfall(fits)
            self._give_up(f"no drift can be fitted: {reason}", "let it rest undisturbed over a wider range")
            return
        self._succeed(fits, because)

    def _on_answer(self, value: str) -> None:
        """``finish``: the operator accepts the covered range."""
        if self._warmth.span < THERMAL_SPAN_MIN:
            self._give_up(
                f"the operator ended it after {self._warmth.span:.1f} degC; a drift needs {THERMAL_SPAN_MIN:.0f} degC",
                "start with a colder vehicle and let it warm up longer",
            )
            return
        fits = self._fit()
        missed = self._shortfall(fits)
        if missed:
            self._warn(f"ended by the operator; {missed}")
        self._end(fits, f"the operator ended it after {self._warmth.span:.1f} degC")

    def _at_end(self) -> None:
        """Data that end while it still warms up are enough if the requested span is covered."""
        if self._warmth.span >= self.options["span"]:
            self._try("the recording ends with the requested span covered", last=False)

    def _missing(self) -> tuple[str, str]:
        span = self._warmth.span
        if self._warmth.moved - span > 2.0:
            return (
                f"the temperature moved by {self._warmth.moved:.1f} degC, but the vehicle was still for "
                f"{span:.1f} degC of it only ({self._why})",
                "leave it alone on a firm surface while the temperature moves",
            )
        if span < self.options["span"]:
            return (
                f"the temperature moved by {span:.1f} degC of {self.options['span']:.0f}",
                "let it warm up longer, start colder, or ask for a smaller span",
            )
        return self._missed or "the drift was not fitted yet", "let it rest undisturbed for longer"

    # -- telling ---------------------------------------------------------------------------------------------------

    def _ask(self, *, still: bool) -> None:
        answers = ("finish",) if self._warmth.span >= THERMAL_SPAN_MIN else ()
        text = "Leave the vehicle alone while its temperature changes."
        if self._warmth.span >= self.options["span"]:
            text = (
                f"The requested {self.options['span']:.0f} degC are covered, and the temperature still changes. Leave "
                "the vehicle alone to widen the range, or finish now."
            )
        if not still:
            text = f"Do not touch it: {self._what}. {text}"
        self._show(Prompt(PromptStep.WARM_UP, text, stable=still, answers=answers))

    def _update_prompt(self, verdict: StillnessVerdict) -> None:
        span, target, rate = self._warmth.span, float(self.options["span"]), self._warmth.rate
        eta = (target - span) / abs(rate) if abs(rate) > 1e-4 and span < target else None
        text = f"{span:.1f} of {target:.0f} degC"
        if self.options["extend"] and span >= target:
            text = f"{span:.1f} degC covered, waiting until it settles (below {self.options['settled']:g} degC/min)"
        settles = self._warmth.settles(self.options["settled"])
        if self.options["extend"] and settles is not None:
            eta = settles.left
            text += (
                f", {60.0 * rate:+.1f} degC/min, will settle at {settles.at:.0f} +- {max(settles.spread, 1.0):.0f} degC"
            )
        elif self.options["extend"]:
            eta = None if span >= target else eta
            text += f", {60.0 * rate:+.1f} degC/min"
        detail = {
            "temperature": {str(i): t for i, t in self._warmth.now.items()},
            "rate_degc_per_min": 60.0 * rate,
            "still_s": self._still,
            "spans": self._spans,
            "missed": self._missed,
            "warnings": self.warnings[:],
        }
        if not verdict.still:
            text += f"; {verdict.why}"
        self._report(Progress(min(span, target), target, "degC", text, eta, detail))
