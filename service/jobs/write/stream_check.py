"""The physical check of a write: stream windows before and after it, and movements that prove the rest."""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Self

import numpy as np

from mavcal.calib.firmware.compose.trim import AHRS_TRIM
from mavcal.calib.firmware.plan import Movement, Value, Verification, WritePlan
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.firmware.stream.auxiliary import ATTITUDE
from mavcal.calib.firmware.stream.rates import requested_streams
from mavcal.calib.preflight.restore import sensors_at_rest
from mavcal.calib.procedures.poses import TEXTS, WEIGHTLESS, down, recognise
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep
from mavcal.calib.recording import Recording, Sensor, join
from mavcal.calib.wire.frames import Frame
from mavcal.calib.wire.tlog import iter_tlog
from mavcal.service.errors import CaptureEnded, WriteFailed
from mavcal.service.jobs.core.handle import JobHandle, waiting
from mavcal.service.jobs.core.model import RESTORE
from mavcal.service.jobs.core.segments import content_of, span_of, spanned
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.rates import ask_for_streams
from mavcal.service.jobs.write.guard import WriteGuard
from mavcal.service.store.rows import SegmentPurpose, SnapshotPurpose
from mavcal.service.vehicle.job_vehicle import JobVehicle

FINISH = "finish"
INERTIAL = (Sensor.ACCEL, Sensor.GYRO)
STEP_S = 2.0
"""Vehicle time between two judgements of a movement, s."""
POLL_S = 0.02
ATTITUDE_HZ = 10.0
PROVING_S = 4.0
"""Time that a prompt asks a pose to be held, s: two such steps."""
RESTS_WITHIN = 0.6
"""Standard deviation of an accelerometer's axis over a second below which a hand holds the vehicle still, m/s2."""
HOLD_STILL = Prompt(
    PromptStep.HOLD_STILL,
    "Leave the vehicle alone: its sensors are read at rest.",
    answers=(FINISH,),
    unfinished="The new values stay unproved.",
)


@dataclass
class Window:
    """A growing recording of one vehicle at the firmware's stage, without gaps inside the ``with`` block."""

    vehicle: JobVehicle
    settings: JobSettings
    clock: Callable[[], float] = time.monotonic
    _assembler: Assembler = field(init=False)
    _chunks: list[Recording] = field(default_factory=list)
    _frames: list[Frame] = field(default_factory=list)
    _forget: Callable[[], None] | None = None

    def __post_init__(self) -> None:
        self._assembler = Assembler(self.vehicle.identity)

    def __enter__(self) -> Self:
        self._forget = self.vehicle.subscribe(
            self._assembler.message_ids, lambda frames, _disk: self._frames.extend(frames)
        )
        return self

    def __exit__(self, *_raised: object) -> None:
        if self._forget is not None:
            self._forget()

    async def extend(self, seconds: float) -> Recording:
        """Add `seconds` of the vehicle's clock; returns everything so far.

        Raises
        ------
        CaptureEnded
            If the samples do not come in time.
        """
        deadline = self.clock() + self.settings.window_timeout_s
        begun: float | None = None
        while True:
            await asyncio.sleep(POLL_S)
            frames, self._frames = self._frames, []
            if frames:
                self._chunks.append(self._assembler.feed([(None, frame) for frame in frames]))
                newest, oldest = _inertial_span(self._chunks[-1])
                begun = oldest if begun is None else begun
                if newest is not None and begun is not None and newest - begun >= seconds:
                    return join(self._chunks)
            if self.clock() > deadline:
                raise CaptureEnded("the vehicle sends no inertial data", remedy="Check its sensors and the link.")


def _inertial_span(chunk: Recording) -> tuple[float | None, float | None]:
    """Newest and oldest time stamp of accelerometers and gyros."""
    spans = [(c.t[-1], c.t[0]) for c in chunk.channels if len(c) and c.sensor in (Sensor.ACCEL, Sensor.GYRO)]
    return (float(max(s[0] for s in spans)), float(min(s[1] for s in spans))) if spans else (None, None)


@dataclass
class StreamCheck:
    """Looks at the stream before and after a write (DESIGN 6, rule 4)."""

    handle: JobHandle
    vehicle: JobVehicle
    plan: WritePlan
    prove_s: float
    settings: JobSettings
    clock: Callable[[], float] = time.monotonic
    _before: Recording | None = None

    async def before(self, guard: WriteGuard) -> None:
        """Keep a window of the stream under the old parameters, in memory and as a segment."""
        await guard.run(self._streams)
        async with spanned(self.handle, self.vehicle, SegmentPurpose.BEFORE):
            with Window(self.vehicle, self.settings, self.clock) as window:
                async with waiting(self.handle, "reading the sensors before the write", self.settings.check_s):
                    self._before = await guard.run(partial(window.extend, self.settings.check_s))

    async def after(self, guard: WriteGuard, values: Mapping[str, Value]) -> Verification:
        """Judge the stream under the new parameters; wait for the movements that prove the rest, if there are any.

        Raises
        ------
        WriteStopped
        WriteFailed
            If there is no stream to judge.
        """
        await guard.run(self._streams)
        before = self._before or await asyncio.to_thread(self._recorded)
        async with spanned(self.handle, self.vehicle, SegmentPurpose.AFTER):
            try:
                return await self._judged(guard, before, values)
            except CaptureEnded as error:
                raise WriteFailed(f"the write cannot be checked: {error}") from error

    async def _judged(self, guard: WriteGuard, before: Recording | None, values: Mapping[str, Value]) -> Verification:
        with Window(self.vehicle, self.settings, self.clock) as window:
            async with waiting(self.handle, "reading the sensors after the write", self.settings.check_s):
                after = await guard.run(partial(window.extend, self.settings.check_s))
            verification = await self._verify(before, after, values)
            begun = after.span[1]
            while self._unsettled(verification, after.span[1] - begun):
                self._look_again(verification, after.span[1] - begun)
                after = await guard.run(partial(window.extend, STEP_S))
                verification = await self._verify(before, after, values)
            begun = after.span[1]
            while self._worth_waiting(verification, after.span[1] - begun):
                self._ask(verification, after.span[1] - begun, after)
                after = await guard.run(partial(window.extend, STEP_S))
                verification = await self._verify(before, after, values)
        self.handle.prompt(None)
        return verification

    def _unsettled(self, verification: Verification, waited: float) -> bool:
        decided = verification.settled or verification.contradicted
        return not decided and waited < self.settings.observe_s and not self._finished()

    def _look_again(self, verification: Verification, waited: float) -> None:
        """Ask to leave the vehicle alone and look again: a short touch must not cause a rollback."""
        self.handle.prompt(HOLD_STILL)
        names = ", ".join(verification.unseen)
        cause = f"no sensor at rest shows {names}" if names else verification.refuted[0].text
        left = self.settings.observe_s - waited
        text = f"{cause}; looking again for up to {left:.0f} s"
        self.handle.progress(Progress(waited, self.settings.observe_s, "s", text, eta=left))

    def _worth_waiting(self, verification: Verification, waited: float) -> bool:
        open_still = verification.movement is not None and not verification.must_go
        return open_still and not self._finished() and waited < self.prove_s

    def _finished(self) -> bool:
        finished = False
        while not self.handle.answers.empty():
            finished |= self.handle.answers.get_nowait() == FINISH
        return finished

    def _ask(self, verification: Verification, waited: float, after: Recording) -> None:
        assert verification.movement is not None
        proved, whole = sum(p.verdict == "proved" for p in verification.parameters), len(verification.parameters)
        self.handle.prompt(proving(verification.movement, whole - proved, pose_at_rest(after)))
        text = f"{proved} of {whole} parameters proved by the stream; waits {self.prove_s - waited:.0f} s at most"
        self.handle.progress(Progress(proved, whole, "parameters", text))  # when the last is proved nobody knows

    async def _verify(self, before: Recording | None, after: Recording, values: Mapping[str, Value]) -> Verification:
        kept = self.handle.store.snapshot(self.handle.id, SnapshotPurpose.COMPOSED_ON)
        known = {**({} if kept is None else kept.body), **values}
        then = None if before is None else self._of_plan(before)
        fits, now = self.handle.job.results, self._of_plan(after)
        found = await asyncio.to_thread(verify, self.plan, fits, then, now, parameters=known)
        if self.handle.job.kind != RESTORE:
            return found
        # without fits the expected readings are unknown, except that the sensors are at rest
        return dataclasses.replace(found, sensors=(*found.sensors, *sensors_at_rest(self.plan, now)))

    @property
    def _sensors(self) -> set[Sensor]:
        """Sensors of the plan and the inertial ones; the parameters of others were not read."""
        return {change.sensor for change in self.plan.changes if change.sensor is not None} | set(INERTIAL)

    def _of_plan(self, recording: Recording) -> Recording:
        """The recording without calibrated sensors that the plan does not concern."""
        beside = set(CALIBRATED) - self._sensors
        return dataclasses.replace(recording, channels=tuple(c for c in recording.channels if c.sensor not in beside))

    async def _streams(self) -> None:
        rates = requested_streams(self.plan.fingerprint.autopilot, self._sensors)
        if any(change.name in AHRS_TRIM for change in self.plan.changes):
            rates[ATTITUDE] = ATTITUDE_HZ  # the only stream that shows ArduPilot's trim
        await ask_for_streams(self.handle, self.vehicle, rates)

    def _recorded(self) -> Recording | None:
        """The window before the write, from the telemetry log; None: there is none."""
        rows = self.handle.store.segments(self.handle.id, SegmentPurpose.BEFORE)
        closed = [row for row in rows if row.end_byte is not None]
        if not closed:
            return None
        data = content_of(span_of(closed[-1]))
        return Assembler(self.vehicle.identity).feed(iter_tlog(data))


def proving(movement: Movement, unproved: int, lies: Pose | None = None) -> Prompt:
    """The prompt for the first step of a movement that proves the rest: one pose at a time.

    `unproved` parameters are open; the vehicle rests in the pose `lies`, None: it moves.
    """
    faces = tuple(Pose(face) for face in movement.faces)
    text, one = movement.text, len(faces) > 0
    if faces:
        more = len(faces) - 1
        text = f"Hold it still {TEXTS[faces[0]]}."
        text += f" Then {more} more pose{'s' if more > 1 else ''}." if more else ""
    elif movement.turn:
        text = "Turn the vehicle slowly through all directions."
    return Prompt(
        PromptStep.PROVE,
        text,
        pose=faces[0] if one else None,
        remaining=faces,
        hold_s=PROVING_S if one else None,
        detected=lies if one else None,
        stable=one and lies == faces[0],
        rotate=movement.turn and not one,
        temperature=movement.temperature,
        answers=(FINISH,),
        unfinished=f"{unproved} parameter{'s' if unproved > 1 else ''} stay{'' if unproved > 1 else 's'} unproved.",
    )


def pose_at_rest(recording: Recording) -> Pose | None:
    """The pose in which the vehicle has rested in the last second; None: it moved, or no accelerometer shows it."""
    for channel in recording.channels:
        if channel.sensor != Sensor.ACCEL or not len(channel):
            continue
        lately = channel.between(float(channel.t[-1]) - 1.0, np.inf).values
        if len(lately) > 1 and np.linalg.norm(lately.mean(axis=0)) > WEIGHTLESS:
            steady = float(lately.std(axis=0).max()) < RESTS_WITHIN
            return recognise(down(lately.mean(axis=0))) if steady else None
    return None
