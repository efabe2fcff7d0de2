"""The writes of an engine: a context for each, and what comes before and after it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from mavcal.calib.recording import Identity
from mavcal.calib.report import from_json
from mavcal.service.errors import VehicleUnknown
from mavcal.service.jobs.core.admission import require_vehicle
from mavcal.service.jobs.core.crashpoints import CrashPoint
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.rates import JobRates
from mavcal.service.jobs.write.attempt import Writing
from mavcal.service.jobs.write.readiness import look_after
from mavcal.service.jobs.write.stream_check import StreamProof
from mavcal.service.jobs.write.transaction import Transaction
from mavcal.service.preflights import History, Preflights
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource


class Writes:
    """Makes transactions, each with the vehicle as it is known then."""

    def __init__(
        self, vehicles: VehicleSource, settings: JobSettings, *, clock: Callable[[], float], reach: CrashPoint
    ) -> None:
        self._vehicles = vehicles
        self._settings = settings
        self._clock, self._reach = clock, reach

    def transaction(self, handle: JobHandle) -> Transaction:
        """The write of a job."""
        return Transaction(handle, lambda: self.attempt(handle.job, handle), self._settings.retry_s)

    def attempt(self, job: Job, handle: JobHandle) -> Writing:
        """A context for writing, with the vehicle as it is known now."""
        assert job.plan is not None
        accept = job.accept or Accept(job.plan.sha256)
        vehicle = self._heard(job)
        check = StreamProof(handle, vehicle, job.plan, accept.prove_s, self._settings, self._clock)
        return Writing(handle, vehicle, job.plan, accept, check, self._settings, self._reach)

    def _heard(self, job: Job) -> JobVehicle:
        """The job's vehicle. One without a unique id is named by a link, and may be heard on another one by now.

        Raises VehicleUnknown. Whether its sensors are those of the plan is asked before anything is sent.
        """
        try:
            vehicle = self._vehicles.vehicle(require_vehicle(job))
        except VehicleUnknown:
            elsewhere = self._elsewhere(job)
            if elsewhere is None:
                raise
            return elsewhere
        gone = vehicle.identity.uid is None and vehicle.condition().silent
        return (self._elsewhere(job) if gone else None) or vehicle

    def _elsewhere(self, job: Job) -> JobVehicle | None:
        """The one vehicle that may be that of a write in doubt, heard on another link than the one that names it."""
        known = job.context.get("identity")
        if job.state != JobState.IN_DOUBT or known is None:
            return None
        found = self._vehicles.nameless(from_json(known, Identity))
        heard = [one for one in found if one.id != job.vehicle_id and not one.condition().silent]
        return heard[0] if len(heard) == 1 else None

    async def applied(self, handle: JobHandle, preflights: Preflights, rates: JobRates, look: History | None) -> None:
        """The write, once nobody returns message rates any more: it needs the same ones as the capture.

        `look`: what is known of the vehicle, with which it is looked at afterwards; None: it is not.
        """
        await preflights.returned(require_vehicle(handle.job))
        await rates.before_write(handle)
        await self.transaction(handle).apply()
        if look is not None:
            with suppress(VehicleUnknown):
                vehicle = self._vehicles.vehicle(require_vehicle(handle.job))
                await look_after(handle, vehicle, preflights, look)
