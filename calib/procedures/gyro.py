"""The gyro's zero-rate offset, from a vehicle at rest.

Rest is judged by the accelerometer as well, since a steady turn is not rest. A turn about a level axis turns gravity;
one about the vertical turns the compass's field. Without a compass only the rate can tell, and the result says so.
"""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.firmware.storable import GYRO
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.gyro.rest import fit_gyro_rest
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, mean_temperature, share_of_information
from mavcal.calib.procedures.motion import StillnessVerdict, statistics
from mavcal.calib.procedures.pool import Pool, Tail
from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Sensor

SPEC = ProcedureSpec(
    kind="gyro",
    title="Gyro offset at rest",
    sensors=(Sensor.GYRO, Sensor.ACCEL),
    aiding=(Sensor.ACCEL,),
    helpful=(Sensor.TEMPERATURE, Sensor.MAG),
    options=(
        Option(
            "uncertainty", float, 0.01, "standard deviation to reach on every axis of every gyro", "deg/s", 0.001, 1.0
        ),
        Option("patience", float, 120.0, "gives up after this time without rest", "s", 10.0, 3600.0),
    ),
    needs="the vehicle lying still on a firm surface; its attitude does not matter",
    ends_on="standard deviation of the offset on every axis of every gyro (0.01 deg/s), or the stream's resolution",
    autopilots=GYRO,
    duration_s=10.0,
    aliases=("gyro-rest",),
)

GUARD_TICKS = 2
"""Ticks before a detected movement that do not count as rest: half a second."""

SHORTEST = 5.0
"""Least time at rest, s: a compass then sees a turn of half a degree per second, and slow disturbances show."""

STALL = 10.0
"""Rest without progress, s, after which the stream's resolution is the limit and more time does not help."""

CHECK_EVERY = 10.0
"""Interval, s, of fits before the goal can be reached, to check that it is a rest."""

FIELD_CHANGE = 0.3
"""Least change of a compass's field that counts as a turn, uT: three steps of a stream in mgauss."""


class GyroProcedure(TickedProcedure):
    """Collects samples of one undisturbed rest until the offsets are known as well as asked for."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = math.radians(options["uncertainty"])
        self._why = "no samples yet"
        self._begin_rest()

    def _begin_rest(self) -> None:
        self._pool = Pool((Sensor.GYRO, Sensor.ACCEL, Sensor.MAG, Sensor.TEMPERATURE))
        self._tail = Tail(GUARD_TICKS)
        self._field = FieldWatch()
        self._spreads: dict[int, Spread] = {}
        self._rest = self._judged_at = self._fitted_at = self._better_at = 0.0
        self._quick = self._best = math.inf

    def _on_start(self, present: set[Instance]) -> None:
        self._show(Prompt(PromptStep.HOLD_STILL, "Put the vehicle on a firm surface and do not touch it."))

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        turned = self._field.update(frame) if verdict.counted else ""
        if not verdict.still or turned:
            self._disturbed(verdict.why or turned, verdict.what or "the field changes")
        elif verdict.counted:
            self._collect(frame, end - start)
        if self.outcome is None:
            self._update_prompt(verdict)

    def _disturbed(self, why: str, what: str) -> None:
        self._why = why
        self._watch.reset()
        self._begin_rest()
        self._show(Prompt(PromptStep.HOLD_STILL, f"Not at rest: {what}. Leave the vehicle alone on a firm surface."))
        if self.elapsed >= self.options["patience"]:
            self._give_up(
                f"no rest that is long enough within {self.elapsed:.0f} s: {why}",
                "put the vehicle on a firm surface away from people and engines, then start again",
            )

    def _collect(self, frame: TickChannels, seconds: float) -> None:
        self._show(Prompt(PromptStep.HOLD_STILL, "At rest: leave the vehicle alone.", stable=True))
        kept = self._tail.push(frame)
        if kept is None:
            return
        self._pool.add(kept)
        for (sensor, instance), channel in kept.items():
            if sensor == Sensor.GYRO:
                self._spreads.setdefault(instance, Spread()).add(channel.values)
        self._rest += seconds
        if self._rest >= SHORTEST and self._rest - self._judged_at >= 1.0:
            self._judged_at = self._rest
            self._judge()

    def _judge(self) -> None:
        """Fit if the goal may be reached, and at intervals before: a fit costs more than the spread."""
        self._quick = max(self._spreads[i].error for i in self.present(Sensor.GYRO) if i in self._spreads)
        if self._quick > self._target and self._rest - self._fitted_at < CHECK_EVERY:
            return
        self._fitted_at = self._rest
        fits = tuple(self._fit(i) for i in self.present(Sensor.GYRO))
        refusal = next((f for f in fits if f.status == FitStatus.REFUSED), None)
        if refusal is not None:
            self._disturbed(f"{label(Sensor.GYRO, refusal.instance)}: {refusal.message}", "it moved or turns steadily")
            return
        reached = max(float(np.nanmax(f.sd[:3])) for f in fits)
        if reached < 0.98 * self._best:
            self._best, self._better_at = reached, self._rest
        if reached <= self._target:
            self._end(fits, f"every offset is known to {math.degrees(reached):.4f} deg/s or better")
        elif self._rest - self._better_at >= max(STALL, 0.1 * self._rest):
            # The deviation of a mean falls by 5 % while the time grows by 10 %, unless the bins are too coarse.
            limit = f"{math.degrees(reached):.4f} deg/s, not {math.degrees(self._target):.4f}"
            self._warn(f"the resolution of the stream allows {limit}: a longer rest does not help")
            self._end(fits, f"the resolution of the stream allows {limit}")

    def _fit(self, instance: int) -> FitResult:
        return fit_gyro_rest(
            self._pool.channel((Sensor.GYRO, instance)),
            accel=self._pool.get((Sensor.ACCEL, instance)),
            mag=next((self._pool.get((Sensor.MAG, i)) for i in self.present(Sensor.MAG)), None),
            temperature=mean_temperature(self._pool, instance),
            relative=self.context.relative,
        )

    def _end(self, fits: tuple[FitResult, ...], because: str) -> None:
        self._dropped_rows()
        if not self._field.seen:
            self._warn(
                "no compass streamed: a slow steady turn about the vertical would look like an offset; "
                "be sure that the vehicle stood still"
            )
        self._succeed(fits, because)

    def _update_prompt(self, verdict: StillnessVerdict) -> None:
        reached = self._offset_sd
        known = math.isfinite(reached)
        # The standard deviation of a mean falls with the square root of the time.
        eta = self._rest * max((reached / self._target) ** 2 - 1.0, 0.0) if known and verdict.counted else None
        text = f"at rest for {self._rest:.0f} s" if verdict.still else self._why
        if verdict.still and known:
            text += f"; offsets known to {math.degrees(reached):.3f} deg/s"
        detail = {
            "rest_s": self._rest,
            "offset_sd_deg_s": math.degrees(reached) if known else None,
            "asked_deg_s": math.degrees(self._target),
            "warnings": self.warnings[:],
        }
        share = share_of_information(self._target, reached) if known else 0.0
        self._report(Progress(share, 100.0, "%", text, eta, detail))

    @property
    def _offset_sd(self) -> float:
        """Standard deviation of the worst offset, rad/s: by the scatter, or by the last fit if that is larger."""
        return max(self._quick, self._best) if math.isfinite(self._best) else self._quick

    def _missing(self) -> tuple[str, str]:
        if not math.isfinite(self._quick):
            return (
                f"the last rest was {self._rest:.1f} s long ({self._why})",
                f"leave the vehicle alone for {SHORTEST + 1.0:.0f} s or more",
            )
        return (
            f"the offsets are known to {math.degrees(self._offset_sd):.4f} deg/s, "
            f"not to {math.degrees(self._target):.4f}",
            "let it rest longer, or ask for less",
        )


class Spread:
    """Standard error of the mean of the added samples under white noise, from running sums."""

    def __init__(self) -> None:
        self._n = 0
        self._origin = np.zeros(3)
        self._sum = np.zeros(3)
        self._squares = np.zeros(3)

    def add(self, values: Array) -> None:
        """Take samples (N, 3)."""
        if self._n == 0:
            self._origin = values[0]
        off = values - self._origin
        self._n += len(off)
        self._sum += off.sum(axis=0)
        self._squares += (off * off).sum(axis=0)

    @property
    def error(self) -> float:
        """Standard error of the worst axis."""
        variance = self._squares / self._n - (self._sum / self._n) ** 2
        return math.sqrt(max(float(variance.max()), 0.0) / self._n)


class FieldWatch:
    """Detects a turn by compass: a mean field that has changed since the rest began."""

    def __init__(self) -> None:
        self.seen = False
        self._first: dict[Instance, list[Array]] = {}
        self._latest: dict[Instance, list[Array]] = {}

    def update(self, frame: TickChannels) -> str:
        """Take a tick at rest; returns the movement that was seen, if any."""
        for instance, channel in frame.items():
            if instance[0] != Sensor.MAG:
                continue
            self.seen = True
            first = self._first.setdefault(instance, [])
            latest = self._latest.setdefault(instance, [])
            (first if len(first) < _FIELD_TICKS else latest).append(channel.values)
            del latest[:-_FIELD_TICKS]
            if len(latest) == _FIELD_TICKS:
                change = _change(np.vstack(first), np.vstack(latest))
                if change:
                    return f"{label(*instance)} sees the field change by {change:.1f} uT: a turn, or something magnetic"
        return ""


_FIELD_TICKS = 8


def _change(before: Array, after: Array) -> float:
    """Change of the mean field, uT, if significant; else 0."""
    a, b = statistics(before), statistics(after)
    error = np.sqrt(a.spread**2 / max(a.n - 1, 1) + b.spread**2 / max(b.n - 1, 1))
    change = np.abs(a.mean - b.mean)
    return float(change.max()) if (change > np.maximum(FIELD_CHANGE, 6.0 * error)).any() else 0.0
