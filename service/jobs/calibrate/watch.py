"""Ends a capture for a reason outside its procedure: an armed, restarted, busy, doubtful or vanished vehicle."""

from __future__ import annotations

import asyncio
import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from mavcal.calib.procedures.protocol import Prompt, PromptStep, Silence
from mavcal.service.errors import CaptureDisturbed, CaptureEnded, CaptureLost, CaptureMoved
from mavcal.service.jobs.calibrate.digest import LiveDigest
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.vehicle.job_vehicle import Condition, JobVehicle

HEARTBEATS_S = 3.0
"""Time without a heartbeat after which a vehicle counts as silent, s."""
SLACK_S = 5.0
"""Error of the comparison between the vehicle's clock and ours: frames wait in buffers, the segment's end is not a
sample's time."""


class LinkWatch:
    """Tells the operator when the vehicle falls silent and when it is heard again."""

    def __init__(
        self, handle: JobHandle, vehicle: JobVehicle, settings: JobSettings, clock: Callable[[], float]
    ) -> None:
        self._handle, self._vehicle, self._settings, self._clock = handle, vehicle, settings, clock
        self._since: float | None = None
        self._before: Prompt | None = None

    def look(self) -> None:
        """Compare the vehicle with what was seen last."""
        silent = self._vehicle.condition().silent
        if silent:
            asked = self._handle.job.prompt
            if self._since is None:
                self._since = self._clock()
            if asked is None or asked.step is not PromptStep.SILENT:
                self._before = asked
            self._handle.prompt(self._prompt(self._clock() - self._since))
        elif not silent and self._since is not None:
            away, self._since = self._clock() - self._since, None
            self._handle.warn(f"the vehicle was silent for about {away + HEARTBEATS_S:.0f} s and is heard again")
            if self._handle.job.prompt is not None and self._handle.job.prompt.step is PromptStep.SILENT:
                self._handle.prompt(self._before)

    def _prompt(self, away: float) -> Prompt:
        """The earlier prompt with a text about the silence, so that none of its steps looks done."""
        limit_s = self._settings.gap_limit_s + HEARTBEATS_S
        text = (
            f"The vehicle is silent: check its power and the link. The job gives up after {limit_s:.0f} s of silence."
        )
        lasted = Silence(float(math.floor(away + HEARTBEATS_S)), limit_s)
        before = self._before or Prompt(PromptStep.SILENT, text)
        return dataclasses.replace(
            before,
            step=PromptStep.SILENT,
            text=text,
            silence=lasted,
            detected=None,
            stable=False,
            taken=False,
            answers=(),
            number=None,
            unfinished="",
        )

    async def run(self) -> None:
        """Look periodically until cancelled."""
        while True:
            self.look()
            await asyncio.sleep(self._settings.watch_s)


@dataclass
class CaptureWatch:
    """Checks the vehicle between two digests; each reason to stop is one sentence with its remedy."""

    vehicle: JobVehicle
    settings: JobSettings
    clock: Callable[[], float]
    warn: Callable[[str], None]
    _reboots: int = field(init=False)
    _way: str = field(init=False)
    _silent_since: float | None = None
    _moved_at: float = field(init=False)
    _last_time: float = float("-inf")
    _before: tuple[float, float, Callable[[], float]] | None = None

    def __post_init__(self) -> None:
        now = self.vehicle.condition()
        self._reboots, self._way = now.reboots, now.way
        self._moved_at = self.clock()

    def resume(self, last_time: float, last_record: float, wall: Callable[[], float]) -> None:
        """Continue a capture whose last record is at `last_record` (wall clock), at `last_time` of the vehicle."""
        self._before = (last_time, last_record, wall)
        self._last_time = last_time

    def look(self, digest: LiveDigest | None) -> None:
        """Raise CaptureEnded or CaptureLost if the capture must end now; `digest` None: no samples are expected."""
        now = self.vehicle.condition()
        self._check_same_boot(digest)
        self._check_state(now)
        if now.way != self._way:
            raise CaptureMoved(
                f"link {self._way} fell silent, and the capture goes on over link {now.way}",
                remedy="What was recorded is kept; start the job again.",
            )
        self._check_silence(now)
        if digest is not None:
            self._check_samples(now, digest)

    def _check_state(self, now: Condition) -> None:
        again = "start the job again"
        if now.armed:
            raise CaptureEnded("the vehicle was armed", remedy=f"Disarm it and {again}.")
        if now.reboots != self._reboots:
            raise CaptureEnded("the vehicle restarted", remedy=f"Wait until it is up again and {again}.")
        if now.calibrating:
            raise CaptureDisturbed(
                "the vehicle began a calibration of its own, which may change what the samples so far rest on",
                remedy=f"Nothing was written. Let it finish, then {again} from its first step.",
            )
        if now.conflict is not None:
            raise CaptureEnded(now.conflict, remedy=f"Give every vehicle its own system id and {again}.")

    def _check_silence(self, now: Condition) -> None:
        if not now.silent:
            if self._silent_since is not None:
                self.warn("the link was lost for a while: the recording has a gap")
            self._silent_since = None
            return
        if self._silent_since is None:
            self._silent_since = self.clock()
        away = self.clock() - self._silent_since
        if away > self.settings.gap_limit_s:
            raise CaptureLost(
                f"the vehicle was silent for {away:.0f} s",
                remedy="Check its power and the link. What was recorded is kept; start the job again.",
            )

    def _check_samples(self, now: Condition, digest: LiveDigest) -> None:
        if digest.last_time > self._last_time or now.silent:
            self._last_time, self._moved_at = max(digest.last_time, self._last_time), self.clock()
        elif self.clock() - self._moved_at > self.settings.stall_s:
            raise CaptureEnded(
                f"the vehicle sent no inertial data for {self.settings.stall_s:.0f} s, although its heartbeat is there",
                remedy="Check that its sensors work and that no other program switches the streams off.",
            )

    def _check_same_boot(self, digest: LiveDigest | None) -> None:
        """After a resume: the vehicle's clock must have advanced at least as long as ours."""
        if self._before is None or digest is None:
            return
        last_time, last_record, wall = self._before
        if not digest.restarted and digest.last_time <= last_time:
            return
        self._before = None
        elapsed, needed = digest.last_time - last_time, wall() - last_record
        if digest.restarted or elapsed < needed - SLACK_S:
            raise CaptureLost(
                "the vehicle restarted while the service was away",
                remedy="What was recorded is kept; start the job again.",
            )
