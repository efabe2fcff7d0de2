"""Scale, cross axes and offset of the gyros on a turntable whose rate is known (METHODS S3).

Neither firmware stores a gyro's scale: only the offset is written, and the scale's error is listed with its cost.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mavcal.calib.firmware import turning_spoils
from mavcal.calib.firmware.storable import GYRO
from mavcal.calib.fit import AXES, FitResult, FitStatus
from mavcal.calib.gyro.rest import PLAUSIBLE_BIAS
from mavcal.calib.gyro.turntable import fit_turntable
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, mean_or_none, mean_temperature, refusals
from mavcal.calib.procedures.body_frame import in_body, in_sensor
from mavcal.calib.procedures.motion import StillnessVerdict
from mavcal.calib.procedures.pool import Pool, Tail, joined
from mavcal.calib.procedures.poses import DOWN, TEXTS, Facing, down_direction, facing
from mavcal.calib.procedures.protocol import Number, Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.procedures.turning import TURNING, Spin, SpinWatch, Turned, way
from mavcal.calib.recording import Array, Channel, Segment, Sensor

SPEC = ProcedureSpec(
    kind="gyro-turntable",
    title="Gyro scale, cross axes and offset on a turntable",
    sensors=(Sensor.GYRO, Sensor.ACCEL),
    aiding=(Sensor.ACCEL,),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option("rate", float, 0.0, "true rate of the turntable; 0: the operator is asked", "deg/s", 0.0, 1000.0),
        Option("rate_sd", float, 0.0, "uncertainty of that rate (one standard deviation)", "deg/s", 0.0, 100.0),
        Option(
            "uncertainty", float, 0.1, "standard deviation of the scale to reach on every axis turned", "%", 0.01, 5.0
        ),
        Option("x", bool, default=True, help="turn about the nose-tail axis (nose up or down)"),
        Option("y", bool, default=True, help="turn about the left-right axis (on a side)"),
        Option("z", bool, default=True, help="turn about the top-bottom axis (level or upside down)"),
        Option("patience", float, 300.0, "gives up after this time without a new turn", "s", 20.0, 3600.0),
    ),
    needs="a turntable of known, steady rate; the vehicle, propellers off, fixed on it with each "
    "axis vertical, turned both ways",
    ends_on="standard deviation of the scale of every axis that is turned (0.1 %), and turns that agree",
    autopilots=GYRO,
    duration_s=120.0,
)
REST_S = 5.0
"""Initial rest, s: it makes the residuals of a single axis testable."""
TURN_S = 5.0
"""Least duration of a turn, s; at least one revolution, unless that takes longer than :data:`LONGEST`."""
LONGEST = 60.0
"""Longest duration of a turn, s."""
SAME_RATE = 2.0
"""Ratio to the stated rate beyond which a turn has another rate."""
ROUNDS = 3
"""Rounds of all turns before giving up."""
_RATE = Number("rate", "deg/s", 1.0, 1000.0)
_FACES = ((Pose.NOSE_DOWN, Pose.NOSE_UP), (Pose.RIGHT, Pose.LEFT), (Pose.LEVEL, Pose.BACK))
GUARD_TICKS = 1
"""Ticks before a detected change that belong to the change: a quarter of a second."""
SETTLE_TICKS = 2
"""First ticks of a stretch that are left out: they may contain the end of a run-up."""
STEADY = 0.05
"""Relative change of the rate above which a tick belongs to another stretch: a run-up, or a slipping turntable."""
STEADY_AT_LEAST = math.radians(1.0)
"""The same for slow turns, rad/s."""


class Stretch:
    """Collects the ticks of one steady turn about `axis` (3,), a body axis; of a rest if it is zero."""

    def __init__(self, axis: Array) -> None:
        self.axis = axis
        self.seconds = 0.0
        self._pool = Pool((Sensor.GYRO, Sensor.TEMPERATURE))
        self._tail = Tail(GUARD_TICKS)
        self._skip = SETTLE_TICKS
        self._rates: list[float] = []
        self._last = math.nan

    def goes_on(self, spin: Spin) -> bool:
        """Whether a tick has the same rate as the previous one."""
        rate = spin.about(self.axis)
        allowed = max(STEADY * abs(rate), STEADY_AT_LEAST)
        return math.isnan(self._last) or abs(rate - self._last) <= allowed

    def add(self, frame: TickChannels, spin: Spin) -> None:
        """Take a tick."""
        self._last = spin.about(self.axis)
        if self._skip > 0:
            self._skip -= 1
            return
        kept = self._tail.push(frame)
        if kept is not None:
            self._pool.add(kept)
            self.seconds += spin.seconds
            self._rates.append(self._last)

    @property
    def error(self) -> float:
        """Standard error of the mean rate, from the scatter of the ticks, rad/s."""
        if len(self._rates) < 4:
            return math.inf
        return float(np.std(self._rates, ddof=1)) / math.sqrt(len(self._rates))

    def channel(self, instance: int) -> Channel | None:
        """Samples of one gyro; None: it has none."""
        return self._pool.get((Sensor.GYRO, instance))

    def temperature(self, instance: int) -> float | None:
        """Mean temperature of an inertial unit, degC; None: it does not stream."""
        return mean_temperature(self._pool, instance)


class GyroTurntableProcedure(TickedProcedure):
    """Takes a rest and steady turns both ways about every requested axis, and fits."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._rate = math.radians(options["rate"])
        self._target = 0.01 * float(options["uncertainty"])
        self._axes = [j for j, name in enumerate(AXES) if options[name]]
        self._taken: list[tuple[str, float, Stretch]] = []
        self._left: list[Turned] = []
        self._round = 0
        self._stretch: Stretch | None = None
        self._doing: Turned | None = None
        self._note = ""
        self._last_taken = -math.inf

    def _on_start(self, present: set[Instance]) -> None:
        self._level = self.bodies(Sensor.ACCEL)
        self._body = self.bodies(Sensor.GYRO)
        self._spins = SpinWatch(self._body)
        if spoilt := turning_spoils(self.context.parameters):
            self._warn(spoilt)
        if not self._axes:
            self._give_up("no axis was chosen", "set at least one of the options x, y and z")
        self._next_round()
        self._show(self._rest_prompt(resting=False))

    def _next_round(self) -> None:
        self._round += 1
        self._left = [Turned(j, sign) for j in reversed(self._axes) for sign in (1.0, -1.0)]

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        spin = self._spins.update(frame, self.present(Sensor.GYRO), end - start, resting=self._at_rest(verdict))
        direction = down_direction(self._watch, self._level, self.present(Sensor.ACCEL))
        if spin is not None and direction is not None:
            if not self._rested:
                self._rest(frame, spin, verdict)
            elif not self._rate:
                self._show(self._rest_prompt(resting=verdict.counted))
            else:
                self._follow(frame, spin, facing(direction))
        if self.outcome is None:
            self._update_prompt()

    def _at_rest(self, verdict: StillnessVerdict) -> bool:
        return verdict.counted and not self._rested

    @property
    def _rested(self) -> bool:
        return bool(self._taken)

    def _rest_prompt(self, *, resting: bool) -> Prompt:
        text = "At rest: leave it alone." if resting else "Fix the vehicle on the turntable and leave it at rest."
        if self._rate:
            return Prompt(PromptStep.HOLD_STILL, text, stable=resting)
        return Prompt(PromptStep.STATE, f"{text} State the true rate of the turntable.", stable=resting, number=_RATE)

    def _rest(self, frame: TickChannels, spin: Spin, verdict: StillnessVerdict) -> None:
        """A rest before the first turn: turns are detected against its offset."""
        if not verdict.still:
            self._stretch = None
        elif verdict.counted:
            self._stretch = self._stretch or Stretch(np.zeros(3))
            self._stretch.add(frame, spin)
            if self._stretch.seconds >= REST_S:
                self._taken.append(("rest", 0.0, self._stretch))
                if self._spins.offset > PLAUSIBLE_BIAS:
                    seen = f"{math.degrees(self._spins.offset):.1f} deg/s"
                    self._warn(f"a gyro reads {seen} at rest: was the turntable turning slowly then?")
                self._stretch = None
        self._show(self._rest_prompt(resting=verdict.counted))

    def _on_answer(self, value: str) -> None:
        rate = _RATE.read(value)
        if rate is not None:
            self._rate = math.radians(rate)

    # -- turns -----------------------------------------------------------------------------------------------------

    def _follow(self, frame: TickChannels, spin: Spin, at: Facing) -> None:
        turned = self._recognised(spin, at)
        if turned is None or turned not in self._left or not self._plausible(spin, turned):
            self._stretch = None
            self._ask(at, spin, turned)
            return
        if self._stretch is None or self._doing != turned or not self._stretch.goes_on(spin):
            self._stretch, self._doing = Stretch(turned.vector), turned
        self._note = ""
        self._stretch.add(frame, spin)
        self._show(self._turn_prompt(at, turned, stable=True))
        if self._complete(self._stretch):
            self._taken.append((f"{turned.name}{self._round}", turned.sign, self._stretch))
            self._left.remove(turned)
            self._stretch, self._last_taken = None, self.time
            if not self._left:
                self._evaluate()
            if self.outcome is None:
                self._ask(at, spin, None)

    def _recognised(self, spin: Spin, at: Facing) -> Turned | None:
        axis = int(np.abs(DOWN[at.face]).argmax())
        turned = Turned(axis, float(np.sign(spin.rate[axis])))
        return turned if at.square and spin.steady_about(turned.vector) else None

    def _plausible(self, spin: Spin, turned: Turned) -> bool:
        rate = spin.about(turned.vector)
        plausible = self._rate / SAME_RATE < rate < self._rate * SAME_RATE
        if not plausible and rate > 2.0 * TURNING:
            self._note = f"It does not turn at the stated {math.degrees(self._rate):g} deg/s. "
        return plausible

    def _complete(self, stretch: Stretch) -> bool:
        least = min(max(TURN_S, 2.0 * math.pi / self._rate), LONGEST)
        known = stretch.error <= self._target * self._rate
        return stretch.seconds >= LONGEST or (stretch.seconds >= least and known)

    def _ask(self, at: Facing, spin: Spin, turned: Turned | None) -> None:
        """Show the next turn: the other way, or with another axis vertical."""
        axis = int(np.abs(DOWN[at.face]).argmax())
        here = [t for t in self._left if t.axis == axis] if at.square else []
        if here:
            wanted = here[0]
            if turned is not None and turned not in self._left and abs(spin.rate[axis]) > TURNING:
                self._note = "This way is done. "
            self._show(self._turn_prompt(at, wanted, stable=False))
        else:
            face = _FACES[self._left[0].axis][0]
            text = f"{self._note}Stop the turntable, and fix the vehicle on it square {TEXTS[face]}."
            self._show(Prompt(PromptStep.PLACE, text, pose=face, remaining=(face,)))

    def _turn_prompt(self, at: Facing, turned: Turned, *, stable: bool) -> Prompt:
        x, y, z = (float(v) + 0.0 for v in turned.vector)  # no negative zeros
        seen = way(np.array(DOWN[at.face]), turned.vector)
        text = (
            "Leave it turning."
            if stable
            else f"Turn it {seen} (seen from above) at {math.degrees(self._rate):g} deg/s."
        )
        return Prompt(PromptStep.TURN, self._note + text, at.face, detected=at.face, stable=stable, axis=(x, y, z))

    # -- judging ---------------------------------------------------------------------------------------------------

    def _evaluate(self) -> None:
        fits = [self._fit(i, math.radians(self.options["rate_sd"])) for i in self.present(Sensor.GYRO)]
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        if not usable:
            self._give_up(
                refusals(fits), "check the stated rate, and that the vehicle is fixed firmly on the turntable"
            )
            return
        reached = max(self._scale_sd(f) for f in usable)
        if reached <= self._target:
            self._end(fits, reached)
        elif (
            self.options["rate_sd"] and max(self._scale_sd(self._fit(f.instance, 0.0)) for f in usable) <= self._target
        ):
            self._give_up(
                f"the scale is known to {100.0 * reached:.3f} %, not to {100.0 * self._target:.3f}: the uncertainty of "
                "the stated rate allows no more",
                "measure the turntable's rate better, or ask for less",
            )
        elif self._round < ROUNDS:
            self._next_round()
            self._note = f"The scale is known to {100.0 * reached:.2f} %: take all turns once more. "
        else:
            self._give_up(
                f"the scale is known to {100.0 * reached:.3f} % after {self._round} rounds, not to "
                f"{100.0 * self._target:.3f}",
                "check that the turntable runs steadily and that the vehicle is fixed on it, or ask for less",
            )

    def _scale_sd(self, fit: FitResult) -> float:
        """Uncertainty of the scale of the worst axis that was turned; `fit` is in the body."""
        return max(float(fit.sd[3 + 4 * j]) for j in self._axes)

    def _fit(self, instance: int, rate_sd: float) -> FitResult:
        """In the body's axes."""
        parts = [
            (label, sign, p) for label, sign, stretch in self._taken if (p := stretch.channel(instance)) is not None
        ]
        segments = [Segment(label, float(p.t[0]), math.nextafter(float(p.t[-1]), math.inf)) for label, _, p in parts]
        rates = {label: sign * self._rate for label, sign, _ in parts}
        return fit_turntable(
            in_body(joined([p for _, _, p in parts]), self._body[instance]),
            rates,
            segments=segments,
            rate_sd=rate_sd,
            temperature=mean_or_none([t for _, _, s in self._taken if (t := s.temperature(instance)) is not None]),
            relative=self.context.relative,
        )

    def _end(self, fits: list[FitResult], reached: float) -> None:
        self._dropped_rows()
        self._warn("a tilt of the vehicle on the turntable enters the cross axes at full size")
        in_raw = [in_sensor(f, self._body[f.instance]) for f in fits]
        self._succeed(in_raw, f"the scale of every axis turned is known to {100.0 * reached:.3f} % or better")

    # -- telling ---------------------------------------------------------------------------------------------------

    def _update_prompt(self) -> None:
        since = self.time - max(self._last_taken, self._began)
        if since >= self.options["patience"]:
            cause, remedy = self._missing()
            self._give_up(f"no new turn within {since:.0f} s; {cause}", remedy)
            return
        total = 2 * len(self._axes) + 1
        done = total - len(self._left) - (not self._rested)
        turning = self._stretch.seconds if self._stretch is not None else 0.0
        text = f"{done} of {total} (a rest, and turns both ways)" + (
            f"; {turning:.0f} s of this one" if turning else ""
        )
        detail: dict[str, Any] = {
            "stretch_s": turning,
            "rate_deg_s": math.degrees(self._rate),
            "round": self._round,
            "warnings": self.warnings[:],
        }
        per_turn = max(TURN_S, 2.0 * math.pi / self._rate) + 8.0 if self._rate else 15.0
        self._report(Progress(done, total, "turns", text, per_turn * (total - done), detail))

    def _missing(self) -> tuple[str, str]:
        if not self._rested:
            return "the vehicle was not at rest", f"leave it at rest on the turntable for {REST_S + 2.0:.0f} s"
        if not self._rate:
            return "the rate of the turntable was not stated", "state it, as an answer or as the option rate"
        names = ", ".join(t.name for t in self._left)
        return f"turns are missing: {names}", "turn it at the stated rate about these body axes (+ is right-handed)"
