"""Capture: switch streams on, read calibration parameters, and feed frames to the procedure until it is done.

The segment of the telemetry log begins before the parameters are read and ends after they were read again. It can
therefore be fitted by itself at any time. Samples from before the reading are left out: the vehicle may have rewritten
its calibration between them and the reading.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

from mavcal.calib.errors import ProcedureError
from mavcal.calib.firmware.in_force.needed import DRIFT_KINDS
from mavcal.calib.firmware.in_force.rewritten import READ_EVERY_S, read_again
from mavcal.calib.firmware.names import CALIBRATION_PREFIXES
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.firmware.stream.rates import requested_streams
from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt, Step
from mavcal.calib.procedures.registry import load_libraries, specification
from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import Frame
from mavcal.calib.wire.tlog import iter_tlog
from mavcal.service.errors import (
    CaptureEnded,
    CommandRefused,
    CommandTimeout,
    DiskFull,
    LinkDown,
    ParameterTimeout,
    VehicleSilent,
)
from mavcal.service.jobs.calibrate.digest import LiveDigest, require_unchanged
from mavcal.service.jobs.calibrate.watch import CaptureWatch, LinkWatch
from mavcal.service.jobs.core.crashpoints import At, CrashPoint, no_crash
from mavcal.service.jobs.core.handle import JobHandle, counting
from mavcal.service.jobs.core.parameters import read_needed
from mavcal.service.jobs.core.segments import captured, close_span, open_span, read_range
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.rates import ask_for_streams
from mavcal.service.store.rows import SegmentPurpose, SegmentRow
from mavcal.service.vehicle.commands import RUN_PREARM_CHECKS
from mavcal.service.vehicle.job_vehicle import JobVehicle, read_values

SILENT_S = 5.0
"""Time without progress after which a capture reports that it waits for samples, wall seconds."""
WAITS = "; waiting for more samples of the vehicle"
BATCH_S = 0.05
"""Least time between two digests of frames, wall seconds."""


@dataclass
class Capture:
    """One capture of one job, begun by this run of the service or by an earlier one."""

    handle: JobHandle
    vehicle: JobVehicle
    settings: JobSettings
    reach: CrashPoint = no_crash
    clock: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time
    foresee: Callable[[Identity, Mapping[str, Value]], Sequence[str]] = lambda _identity, _parameters: ()
    """Returns the warnings that follow from the parameters alone, before the operator has anything to do."""
    parameters: dict[str, Value] = field(default_factory=dict)
    """Parameters that the job rests on; the calibration is the same before and after the capture."""
    _frames: list[Frame] = field(default_factory=list)
    _reported_at: float = -math.inf
    _disk: DiskFull | None = None

    async def run(self) -> Done:
        """Capture until the procedure is done. However it ends, the segments of the job are closed then.

        Raises
        ------
        CaptureEnded
            With a remedy, if the capture cannot be used.
        CaptureLost
            If the vehicle was away for too long, or is another boot than before a restart of the service.
        DiskFull, VehicleError, LinkError
        """
        link = asyncio.create_task(LinkWatch(self.handle, self.vehicle, self.settings, self.clock).run())
        loading = asyncio.create_task(asyncio.to_thread(load_libraries))  # while the vehicle is waited for
        try:
            with self.vehicle.unbroken_tlog():
                return await self._recorded()
        finally:
            link.cancel()
            await asyncio.gather(link, loading, return_exceptions=True)

    async def _recorded(self) -> Done:
        earlier = captured(self.handle.job, self.handle.store)
        for row in earlier:
            if row.end_byte is None:
                await close_span(self.handle.store, row, None)
        rates = requested_streams(self.vehicle.identity.autopilot or "", specification(self.handle.job.kind).sensors)
        await ask_for_streams(self.handle, self.vehicle, rates, measure_s=self.settings.measure_s)
        # Only now: on a bad link the requests take long, and a replay of the streams that came first would not wait
        # for the others. The segment and the frames begin at the same place, so that live and replay see the same.
        position, forget = await self.vehicle.record(Assembler(self.vehicle.identity).message_ids, self._take)
        try:
            row = await open_span(self.handle.store, self.handle.id, SegmentPurpose.CAPTURE, position)
            try:
                return await self._captured(earlier)
            finally:
                await asyncio.shield(close_span(self.handle.store, row, self.vehicle))
                self.reach(At.CAPTURE_CLOSED)
        finally:
            forget()

    async def _captured(self, earlier: Sequence[SegmentRow]) -> Done:
        self.reach(At.CAPTURE_STARTED)
        identity = await self.vehicle.identify()
        if identity.autopilot == "px4":  # only there it says whose device id is in none of its rows
            with suppress(CommandRefused, CommandTimeout):
                await self.vehicle.command(RUN_PREARM_CHECKS, ())
        kind = self.handle.job.kind
        progress = counting(self.handle, "reading the calibration in force")
        sensors = specification(kind).sensors
        read = await read_needed(self.vehicle, sensors, drift=kind in DRIFT_KINDS, progress=progress)
        self.parameters = {name: reading.value for name, reading in read.items()}
        for text in await asyncio.to_thread(self.foresee, identity, self.parameters):
            self.handle.warn(text)
        digest, watch = await self._begin(identity, earlier)
        reading = asyncio.create_task(self._reading(read_again(kind, identity.autopilot, self.parameters), digest))
        try:
            done = await self._until_done(digest, watch)
        finally:
            reading.cancel()
            await asyncio.wait({reading})
        if not reading.cancelled():
            reading.result()  # a defect there would leave changes unseen
        self.handle.prompt(None)  # nothing is asked of anybody any more
        self._set_state(JobState.RUNNING)
        await self._read_again(identity, watch)
        return done

    def _take(self, frames: Sequence[Frame], disk: DiskFull | None) -> None:
        self._frames += frames
        self._disk = disk or self._disk

    async def _begin(self, identity: Identity, earlier: Sequence[SegmentRow]) -> tuple[LiveDigest, CaptureWatch]:
        """A digest that has replayed the segments of earlier runs of the service."""
        job = self.handle.job
        digest = LiveDigest(job.kind, job.options, identity, self.parameters, job.created_at)
        digest.schedule([(t, value) for t, value in job.context.get("answers", ())])
        last_record = 0.0
        for row in earlier:
            data = await asyncio.to_thread(read_range, row.path, row.start_byte, row.end_byte)
            records = list(iter_tlog(data))
            self._announce(await asyncio.to_thread(digest.feed, [frame for _, frame in records]))
            last_record = records[-1][0] / 1e6 if records else last_record
        watch = CaptureWatch(self.vehicle, self.settings, self.clock, self.handle.warn)
        if earlier:
            watch.resume(digest.last_time, last_record, self.wall)
        return digest, watch

    async def _until_done(self, digest: LiveDigest, watch: CaptureWatch) -> Done:
        while True:
            await asyncio.sleep(BATCH_S)
            steps = self._answered(digest)
            frames, self._frames = self._frames, []
            if self._disk is not None:  # first: a capture that is done already may lack what it rests on
                raise self._disk
            if frames:
                steps += await asyncio.to_thread(digest.feed, frames)
            self._announce(steps)
            self._announce_wait()
            self.reach(At.CAPTURE_RUNNING)
            outcome = digest.outcome
            for warning in digest.warnings:
                self.handle.warn(warning)
            if isinstance(outcome, Done):
                return outcome
            watch.look(digest)
            if isinstance(outcome, GaveUp):
                raise CaptureEnded(outcome.cause, remedy=outcome.remedy)

    async def _reading(self, names: Sequence[str], digest: LiveDigest) -> None:
        """Read parameters that the vehicle rewrites by itself, for unnoticed changes; answers go into the segment."""
        asked_at = digest.last_time
        while names:
            await asyncio.sleep(BATCH_S)
            if digest.last_time - asked_at >= READ_EVERY_S or digest.last_time < asked_at:
                asked_at = digest.last_time
                with suppress(VehicleSilent, ParameterTimeout, LinkDown):
                    await read_values(self.vehicle, names)

    def _announce_wait(self) -> None:
        """Announce that samples are awaited: a procedure counts samples, and reports nothing while none are usable."""
        now, last = self.clock(), self.handle.job.progress
        if math.isinf(self._reported_at):
            self._reported_at = now
        if now - self._reported_at < SILENT_S or last is None:
            return
        self._reported_at = now
        self.handle.progress(replace(last, text=f"{last.text.partition(WAITS)[0]}{WAITS}", eta=None))

    def _answered(self, digest: LiveDigest) -> list[Step]:
        """Hand answers to the procedure; accepted ones are kept with its time, for the replay."""
        steps: list[Step] = []
        while not self.handle.answers.empty():
            value = self.handle.answers.get_nowait()
            given = [*self.handle.job.context.get("answers", ()), [max(digest.time, 0.0), value]]
            try:
                steps += digest.answer(value)
            except ProcedureError as error:  # the prompt has changed since it was answered
                self.handle.warn(f"the answer came too late: {error}")
                continue
            self.handle.change("answer", {"value": value}, context={**self.handle.job.context, "answers": given})
        return steps

    def _announce(self, steps: Sequence[Step]) -> None:
        """Announce prompts and progress."""
        for step in steps:
            if isinstance(step, Prompt):
                self.handle.prompt(step)
                self._set_state(JobState.WAITING_FOR_OPERATOR if _needs_operator(step) else JobState.RUNNING)
            elif isinstance(step, Progress):
                self._reported_at = self.clock()
                self.handle.progress(step)

    def _set_state(self, state: JobState) -> None:
        if self.handle.job.state != state:
            self.handle.move(state)

    async def _read_again(self, identity: Identity, watch: CaptureWatch) -> None:
        """Read the calibration again, because an unnoticed change would make the capture useless."""
        prefixes = CALIBRATION_PREFIXES[identity.autopilot or ""]
        names = [name for name in self.parameters if name.startswith(prefixes)]
        progress = counting(self.handle, "reading the calibration again")
        while True:
            try:
                readings = await read_values(self.vehicle, names, progress=lambda done: progress(done, len(names)))
                break
            except (VehicleSilent, ParameterTimeout, LinkDown):
                watch.look(None)
                await asyncio.sleep(self.settings.watch_s)
        for name, reading in readings.items():
            require_unchanged(self.handle.job.kind, name, self.parameters[name], reading.value)


def _needs_operator(prompt: Prompt) -> bool:
    """Whether the operator has to do something now, and is not already doing it."""
    if prompt.rotate or prompt.number is not None:
        return True
    moves = bool(prompt.remaining) or prompt.pose is not None or prompt.axis is not None
    return moves and (not prompt.stable or prompt.taken)
