"""Base of all procedures: ticks, roster of instances, prompts, answers, and the end."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Sequence
from typing import ClassVar

from mavcal.calib.errors import ProcedureError
from mavcal.calib.firmware.plan import LeftOut
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.intake import Intake, Tick
from mavcal.calib.procedures.motion import RESTING, StillLimits, StillWatch
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt, Step
from mavcal.calib.procedures.roster import (
    ROSTER,
    ROSTER_EXPECTED,
    Attendance,
    Instance,
    Roster,
    TickChannels,
    choose,
    label,
)
from mavcal.calib.procedures.spec import OperatorAnswer, Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Recording, Sensor

PROGRESS_EVERY = 1.0
"""Interval of progress reports, s of the vehicle's clock."""


class TickedProcedure(ABC):
    """A procedure that decides at the ticks of :mod:`calib.procedures.intake`.

    Subclasses hold the state of one run and report through :meth:`_show`, :meth:`_report` and :meth:`_finish`. Every
    decision depends on ticks alone.
    """

    spec: ClassVar[ProcedureSpec]
    limits: ClassVar[StillLimits] = RESTING
    """What counts as still in this procedure."""

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        self.options = options
        self.context = context
        self.time = -math.inf
        """End of the last processed tick, s on the vehicle's clock; the time stamp of answers."""
        self.outcome: Done | GaveUp | None = None
        self.warnings: list[str] = []
        self._left_out: dict[Instance, str] = {}
        self._intake = Intake()
        self._backlog: list[Tick] = []
        self._roster: Roster | None = None
        self._attendance = Attendance(set())
        self._watch = StillWatch(self.limits, ())
        self._scheduled: list[OperatorAnswer] = []
        self._steps: list[Step] = []
        self._prompt: Prompt | None = None
        self._reported = -math.inf
        self._began = math.nan

    def feed(self, chunk: Recording) -> tuple[Step, ...]:
        """Take the next raw samples; return what changed."""
        if self.outcome is None:
            self._intake.add(chunk)
            self._work(to_the_end=False)
        return self._new_steps()

    def end(self) -> tuple[Step, ...]:
        """End of the samples: process the rest, then report what is missing."""
        if self.outcome is None:
            self._work(to_the_end=True)
            self._apply_scheduled(math.inf)
        if self.outcome is None:
            if self._roster is None:
                self._settle_roster()
            if self.outcome is None:
                self._at_end()
            if self.outcome is None:
                cause, remedy = self._missing()
                self._give_up(f"the recording ends before the goal is reached: {cause}", remedy)
        return self._new_steps()

    def answer(self, value: str) -> tuple[Step, ...]:
        """Take an operator's answer."""
        if self.outcome is not None:
            raise ProcedureError(f"the {self.spec.kind} procedure has ended; it takes no answer {value!r}")
        if self._prompt is None or not self._prompt.accepts(value):
            choice = (self._prompt.choice if self._prompt else "") or "none: the data answer"
            raise ProcedureError(f"{value!r} is no answer to this step; it accepts {choice}")
        self._on_answer(value)
        return self._new_steps()

    def schedule(self, answers: Sequence[OperatorAnswer]) -> None:
        """Give these answers when the procedure's `time` comes to theirs (a replayed job)."""
        self._scheduled = sorted([*self._scheduled, *answers], key=lambda a: a.t)

    @property
    def elapsed(self) -> float:
        """Seconds of the vehicle's clock since the first tick."""
        return self.time - self._began

    # -- what a procedure is made of -------------------------------------------------------------------------------

    @abstractmethod
    def _on_start(self, present: set[Instance]) -> None:
        """Called once, when the sensors that take part are known."""

    @abstractmethod
    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        """Take a tick's samples."""

    @abstractmethod
    def _missing(self) -> tuple[str, str]:
        """Cause and remedy, in words, while the goal is not reached."""

    def _at_end(self) -> None:  # noqa: B027 - most have nothing to do then
        """Called at the end of the samples: finish if they are enough."""

    def _on_answer(self, value: str) -> None:
        raise ProcedureError(f"the {self.spec.kind} procedure takes no answers")

    def _on_dropout(self, instance: Instance) -> None:
        """Called when a sensor drops out, after the operator was warned."""
        self._watch.drop(instance)

    # -- what a procedure says -------------------------------------------------------------------------------------

    def _show(self, prompt: Prompt) -> None:
        if prompt != self._prompt:
            self._prompt = prompt
            self._steps.append(prompt)

    def _report(self, progress: Progress) -> None:
        if self.time - self._reported >= PROGRESS_EVERY:
            self._reported = self.time
            self._steps.append(progress)

    def _warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)

    def _leave_out(self, instance: Instance, reason: str) -> None:
        """Exclude an instance; `reason` continues the text "is left out:"."""
        self._warn(f"{label(*instance)} is left out: {reason}")
        self._left_out.setdefault(instance, reason)

    def _fell_out(self, instance: Instance, reason: str) -> None:
        """Remove an instance from the procedure; `reason` is a sentence that names it."""
        self._warn(f"{reason}; it is left out")
        self._left_out.setdefault(instance, f"it {reason.removeprefix(label(*instance)).strip()}")

    def _finish(self, outcome: Done | GaveUp) -> None:
        if self.outcome is not None:
            return
        if isinstance(outcome, Done):
            outcome = dataclasses.replace(outcome, left_out=self._missed_by(outcome))
        self.outcome = outcome
        self._steps.append(outcome)

    def _missed_by(self, done: Done) -> tuple[LeftOut, ...]:
        fitted = {(fit.sensor, fit.instance) for fit in done.results}
        missed = [i for i in sorted(self._left_out) if i[0] in self.spec.sensors and i not in fitted]
        return tuple(LeftOut(*instance, self._left_out[instance]) for instance in missed)

    def _succeed(self, fits: Iterable[FitResult], because: str) -> None:
        """End with these fits, each with the warnings of the capture."""
        self._dropped_rows()
        self._finish(Done(tuple(annotated(fit, self.context, self.warnings) for fit in fits), because))

    def _give_up(self, cause: str, remedy: str) -> None:
        self._finish(GaveUp(cause, remedy))

    # -- the machinery ---------------------------------------------------------------------------------------------

    def present(self, sensor: Sensor) -> tuple[int, ...]:
        """Instances of `sensor` that take part now."""
        return tuple(sorted(i for s, i in self._attendance.present if s == sensor))

    def bodies(self, sensor: Sensor) -> dict[int, Array]:
        """Rotation (3, 3) from the raw frame to the body of each instance that takes part now."""
        return {i: self.context.body_from_sensor(sensor, i) for i in self.present(sensor)}

    def _work(self, *, to_the_end: bool) -> None:
        for tick in self._intake.ticks(to_the_end=to_the_end):
            if self._roster is None:
                self._backlog.append(tick)
                if self._roster_ready(tick):
                    self._settle_roster()
            else:
                self._process_tick(tick)
            if self.outcome is not None:
                return
        if self._intake.broken:
            if self._roster is None and self._backlog:
                self._settle_roster()
            self._give_up(self._intake.broken.cause, self._intake.broken.remedy)

    def _roster_ready(self, tick: Tick) -> bool:
        seen = {(key[0], key[1]) for t in self._backlog for key in t.channels}
        expected = {(s, i) for s, instances in self.context.instances.items() for i in instances}
        needed = {s for s, _ in seen} >= set(self.spec.sensors) and seen >= expected
        return tick.end - self._backlog[0].start >= (ROSTER if needed else ROSTER_EXPECTED)

    def _settle_roster(self) -> None:
        backlog, self._backlog = self._backlog, []
        wanted = {*self.spec.sensors, *self.spec.helpful}
        chosen = choose(backlog).keys
        self._roster = Roster({i: k for i, k in chosen.items() if i[0] in wanted})
        self._intake.keep(self._roster.keys.values())
        present = set(self._roster.keys)
        for sensor in self.spec.sensors:
            if not any(s == sensor for s, _ in present):
                text = f"the vehicle streams no {sensor} samples"
                self._give_up(text, "check that the sensor is there and that the stream is allowed on this link")
                return
            for instance in self.context.instances.get(sensor, ()):
                if (sensor, instance) not in present:
                    self._leave_out((sensor, instance), "the vehicle sends no samples of it")
        self._attendance = Attendance(set(present))
        self._watch = StillWatch(self.limits, present)
        self._began = backlog[0].start
        self._on_start(present)
        for tick in backlog:
            if self.outcome is None:
                self._process_tick(tick)

    def _process_tick(self, tick: Tick) -> None:
        assert self._roster is not None
        self._apply_scheduled(self.time)
        if self.outcome is not None:
            return
        frame = self._roster.frame(tick)
        for instance, reason in self._attendance.update(frame):
            self._lose(instance, reason)
        if self.outcome is None:
            self.time = tick.end
            self._on_tick(tick.start, tick.end, {i: c for i, c in frame.items() if i in self._attendance.present})

    def _lose(self, instance: Instance, reason: str) -> None:
        self._fell_out(instance, reason)
        if instance[0] in self.spec.sensors and not self.present(instance[0]):
            self._give_up(reason, "restart the vehicle; if it stays so, the sensor or its wiring is broken")
            return
        self._on_dropout(instance)

    def _apply_scheduled(self, until: float) -> None:
        while self._scheduled and self._scheduled[0].t <= until and self.outcome is None:
            self._on_answer(self._scheduled.pop(0).value)

    def _new_steps(self) -> tuple[Step, ...]:
        steps, self._steps = tuple(self._steps), []
        return steps

    def _dropped_rows(self) -> None:
        """Warn of rows that were not samples (NaN and the like)."""
        for (sensor, instance, source), n in self._intake.dropped.items():
            self._warn(f"{n} rows of {label(sensor, instance)} in {source} were no finite numbers and were left out")


def mean_temperature(pool: Pool, instance: int) -> float | None:
    """Mean temperature of an inertial unit over the kept samples, degC; None: it is not streamed."""
    key = (Sensor.TEMPERATURE, instance)
    return float(pool.channel(key).values.mean()) if key in pool else None


def mean_or_none(values: Collection[float]) -> float | None:
    """Their mean; None: there are none."""
    return math.fsum(values) / len(values) if values else None


def annotated(fit: FitResult, context: ProcedureContext, warnings: Iterable[str]) -> FitResult:
    """The fit with the capture's warnings, and `relative` if the calibration in force is unknown."""
    extra = tuple(w for w in warnings if w not in fit.warnings)
    return dataclasses.replace(fit, warnings=fit.warnings + extra, relative=fit.relative or context.relative)


def share_of_information(target: float, reached: float) -> float:
    """Information at a standard deviation of `reached`, as a percentage of that at `target`.

    Information is ``1/sd^2`` and grows linearly with the samples, so a progress bar of it moves evenly.
    """
    return 100.0 * min(1.0, (target / reached) ** 2) if math.isfinite(reached) and reached > 0.0 else 0.0


def refusals(fits: Iterable[FitResult]) -> str:
    """Reasons why fits were refused, sensor by sensor."""
    refusals = [f"{label(f.sensor, f.instance)}: {f.message}" for f in fits if f.status == FitStatus.REFUSED]
    return "; ".join(refusals) or "no sensor is left"
