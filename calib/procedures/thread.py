"""Scale and offset of the gyros about one axis from whole turns on a thread (METHODS S3).

No turntable is needed and the rate need not be steady: the turns are counted by a compass or by the operator. Neither
firmware stores a gyro's scale: only the offset is written, and the scale's error is listed with its cost.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib.firmware import turning_spoils
from mavcal.calib.firmware.storable import GYRO
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.gyro.thread import fit_thread
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, mean_temperature, refusals
from mavcal.calib.procedures.body_frame import in_body, in_sensor
from mavcal.calib.procedures.intake import TICK
from mavcal.calib.procedures.motion import RESTING, StillnessVerdict
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.poses import DOWN, TEXTS, down_direction, facing
from mavcal.calib.procedures.protocol import Number, Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.procedures.turning import TURNING, Spin, SpinWatch, way
from mavcal.calib.recording import Array, Segment, Sensor

SPEC = ProcedureSpec(
    kind="gyro-thread",
    title="Gyro scale and offset from whole turns on a thread",
    sensors=(Sensor.GYRO, Sensor.ACCEL),
    aiding=(Sensor.ACCEL,),
    helpful=(Sensor.MAG, Sensor.TEMPERATURE),
    options=(
        Option("turns", float, 10.0, "whole turns to make each way, from rest to rest", "", 1.0, 200.0),
        Option("angle_sd", float, 5.0, "how far from whole the turns may be where no compass counts", "deg", 0.0, 90.0),
        Option("uncertainty", float, 0.2, "standard deviation of the scale to reach", "%", 0.01, 5.0),
        Option("patience", float, 300.0, "gives up after this time without new turns", "s", 20.0, 3600.0),
    ),
    needs="the vehicle, propellers off, hung on a thread, or on a swivel chair, turned by whole "
    "turns one way and as many back, twice",
    ends_on="standard deviation of the scale about the thread (0.2 %), and turns that agree",
    autopilots=GYRO,
    duration_s=180.0,
)

HANGING = dataclasses.replace(RESTING, accel_wander=0.3, gyro_wander=math.radians(2.0))
"""Limits of rest for a vehicle on a thread, which still swings by a degree or two."""

ROUNDS = 2
"""Least turns each way: fewer leave no residual to test the fit."""

MOST_ROUNDS = 4
"""Most turns each way before giving up."""

LEAST_TURN = 0.9 * 2.0 * math.pi
"""Least angle of a turn, rad; a smaller movement is handling."""

ONE_WAY = 0.03
"""Largest fraction of the angle in the opposite direction, since a thread swings back before it rests."""

_TURNS = Number("turns", "", 1.0, 200.0)


@dataclass(frozen=True)
class Wound:
    """Turns one way from rest to rest: `angle` as the gyro has it, rad, signed."""

    start: float
    end: float
    angle: float


class GyroThreadProcedure(TickedProcedure):
    """Finds the turns between rests, has them counted, and fits."""

    spec = SPEC
    limits = HANGING

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = 0.01 * float(options["uncertainty"])
        self._wanted = ROUNDS
        self._counted: float | None = None
        self._pool = Pool((Sensor.GYRO, Sensor.MAG, Sensor.TEMPERATURE))
        self._wound: list[Wound] = []
        self._down: Array | None = None
        self._face: Pose | None = None
        self._axis: Array | None = None
        self._rest_end = math.nan
        self._angle = self._path = 0.0
        self._asking = False
        self._note = ""
        self._last_taken = -math.inf

    def _on_start(self, present: set[Instance]) -> None:
        self._level = self.bodies(Sensor.ACCEL)
        self._body = self.bodies(Sensor.GYRO)
        self._spins = SpinWatch(self._body)
        if spoilt := turning_spoils(self.context.parameters):
            self._warn(spoilt)
        self._show(self._rest_prompt())

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        self._pool.add(frame)
        resting = verdict.counted and not self._wound
        spin = self._spins.update(frame, self.present(Sensor.GYRO), end - start, resting=resting)
        if spin is not None and not self._asking:
            if self._resting(verdict, spin):
                self._rested(end, verdict)
            elif not math.isnan(self._rest_end):
                self._turned(spin)
        if self.outcome is None:
            self._update_prompt()

    def _resting(self, verdict: StillnessVerdict, spin: Spin) -> bool:
        """Whether the vehicle rests, by its rate: within one tick a steady slow turn looks still."""
        return verdict.counted and (not self._spins.rested or float(np.linalg.norm(spin.rate)) < 0.3 * TURNING)

    def _rested(self, end: float, verdict: StillnessVerdict) -> None:
        begun = end - verdict.ticks * TICK
        if not math.isnan(self._rest_end) and abs(self._angle) >= LEAST_TURN:
            self._keep(Wound(self._rest_end - TICK, begun + 2.0 * TICK, self._angle))
        self._rest_end, self._angle, self._path = end, 0.0, 0.0
        direction = down_direction(self._watch, self._level, self.present(Sensor.ACCEL))
        if direction is not None:
            at = facing(direction)
            self._down, self._face = np.array(DOWN[at.face]), at.face if at.square else None
        if self.outcome is None and not self._asking:
            self._show(self._rest_prompt() if self._down is None else self._turn_prompt(stable=False))

    def _turned(self, spin: Spin) -> None:
        if self._down is None:
            return
        axis = self._down if self._axis is None else self._axis
        self._angle += spin.about(axis) * spin.seconds
        self._path += abs(spin.about(axis)) * spin.seconds
        if abs(spin.about(axis)) > TURNING:
            self._show(self._turn_prompt(stable=True))

    def _keep(self, wound: Wound) -> None:
        self._note = ""
        if self._path - abs(wound.angle) > ONE_WAY * self._path:
            self._note = "It turned back before it came to rest, so these turns do not count. "
            return
        if self._face is None:
            self._note = "No axis of the vehicle was vertical: hang it straight; these turns do not count. "
            return
        self._axis = self._down if self._axis is None else self._axis
        self._wound.append(wound)
        self._last_taken = self.time
        if not self._missing_signs():
            self._evaluate()

    def _missing_signs(self) -> list[float]:
        """Signs of the turns that are still wanted about the axis, in the order in which they are asked for."""
        ways = [math.copysign(1.0, w.angle) for w in self._wound]
        left = {sign: self._wanted - ways.count(sign) for sign in (1.0, -1.0)}
        first = -ways[-1] if ways else 1.0
        order = [first, -first] * self._wanted
        found = []
        for sign in order:
            if left[sign] > 0:
                left[sign] -= 1
                found.append(sign)
        return found

    # -- judging ---------------------------------------------------------------------------------------------------

    def _evaluate(self) -> None:
        if self._counted is None and not self.present(Sensor.MAG):
            self._ask_for_turns()
            return
        fits = [self._fit(i) for i in self.present(Sensor.GYRO)]
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        if not usable:
            if self._counted is None:
                self._ask_for_turns()
            else:
                self._give_up(refusals(fits), "count the turns from rest to rest, the same number each way")
            return
        reached = max(_scale_sd(f) for f in usable)
        if reached <= self._target:
            self._end(fits, reached)
        elif self._wanted < MOST_ROUNDS:
            self._wanted += 1
            self._note = f"The scale is known to {100.0 * reached:.2f} %: once more each way. "
        else:
            self._give_up(
                f"the scale is known to {100.0 * reached:.3f} %, not to {100.0 * self._target:.3f}",
                "make more turns each way, away from steel if a compass counts them, or ask for less",
            )

    def _ask_for_turns(self) -> None:
        self._asking = True
        seen = ", ".join(f"{abs(w.angle) / (2.0 * math.pi):.1f}" for w in self._wound)
        self._show(
            Prompt(
                PromptStep.STATE,
                f"How many whole turns were made each way? No compass counted them; the gyro saw {seen}.",
                stable=True,
                number=_TURNS,
            )
        )

    def _on_answer(self, value: str) -> None:
        self._counted = _TURNS.read(value)
        self._asking = False
        self._evaluate()

    def _fit(self, instance: int) -> FitResult:
        """Fit of one gyro in the body's axes."""
        gyro = in_body(self._pool.channel((Sensor.GYRO, instance)), self._body[instance])
        mag = next((self._pool.get((Sensor.MAG, i)) for i in self.present(Sensor.MAG)), None)
        counted = self._counted is not None
        return fit_thread(
            gyro,
            turns=self._counted,
            mag=None if counted else mag,
            segments=[Segment(f"turns {k + 1}", w.start, w.end) for k, w in enumerate(self._wound)],
            angle_sd=math.radians(self.options["angle_sd"]) if counted else 0.0,
            temperature=mean_temperature(self._pool, instance),
            relative=self.context.relative,
        )

    def _end(self, fits: list[FitResult], reached: float) -> None:
        by = "a compass" if self._counted is None else "the operator"
        in_raw = [in_sensor(f, self._body[f.instance]) for f in fits]
        self._succeed(in_raw, f"the scale is known to {100.0 * reached:.3f} %; the turns were counted by {by}")

    # -- telling ---------------------------------------------------------------------------------------------------

    def _rest_prompt(self) -> Prompt:
        return Prompt(PromptStep.HOLD_STILL, f"{self._note}Hang the vehicle up and let it come to rest.")

    def _turn_prompt(self, *, stable: bool) -> Prompt:
        down = self._down if self._axis is None else self._axis
        assert down is not None
        axis = self._missing_signs()[0] * down
        x, y, z = (float(v) + 0.0 for v in axis)
        turns = float(self.options["turns"])
        text = (
            f"{self._note}Let it turn {turns:g} whole turns {way(down, axis)} (seen from above), then come to rest."
            if not stable
            else "Let it go on, and come to rest."
        )
        return Prompt(PromptStep.TURN, text, self._face, stable=stable, axis=(x, y, z), turns=turns)

    def _update_prompt(self) -> None:
        since = self.time - max(self._last_taken, self._began)
        if since >= self.options["patience"]:
            cause, remedy = self._missing()
            self._give_up(f"nothing new within {since:.0f} s; {cause}", remedy)
            return
        total = 2 * self._wanted
        done = total - len(self._missing_signs())
        turns = abs(self._angle) / (2.0 * math.pi)
        text = f"{done} of {total} times turned" + (f"; {turns:.1f} turns of this one" if turns > 0.1 else "")
        per = (self.time - self._began) / done if done else SPEC.duration_s / total
        detail: dict[str, Any] = {
            "turns": turns,
            "counted_by_compass": bool(self.present(Sensor.MAG)) and self._counted is None,
            "axis": None if self._face is None else TEXTS[self._face],
            "warnings": self.warnings[:],
        }
        self._report(Progress(done, total, "times", text, per * (total - done), detail))

    def _missing(self) -> tuple[str, str]:
        if self._asking:
            return "the number of turns was not stated", "answer how many whole turns were made each way"
        ways = self._missing_signs()
        return (
            f"turns were made {len(self._wound)} times; {ways.count(1.0)} one way, {ways.count(-1.0)} back are missing",
            "let it turn by whole turns from rest to rest, both ways, twice",
        )


def _scale_sd(fit: FitResult) -> float:
    """Scale uncertainty about the axis of the thread, the only one determined; `fit` is in body axes."""
    names = (f"matrix_{a}{a}" for a in "xyz")
    return max(float(fit.sd[3 + 4 * j]) for j, name in enumerate(names) if fit.determined(name))
