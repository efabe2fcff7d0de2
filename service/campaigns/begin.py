"""Checks and begins campaigns; defines the work of each task in a running service."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.procedures.registry import specification, validate_options
from mavcal.service.campaigns.campaigns import CAMPAIGN, Campaigns, CampaignTask, ItemWork
from mavcal.service.campaigns.uploads import UploadFits, UploadGaps
from mavcal.service.campaigns.vehicles import VEHICLES_AT_ONCE, CalibrationWork, Patience, PreflightWork, RestoreWork
from mavcal.service.errors import Forbidden
from mavcal.service.jobs.calibrate.planning import checked_plan_options, confirmed, require_sensors_of
from mavcal.service.jobs.core.admission import require_finite
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.jobs.uploads import Computations
from mavcal.service.store.rows import RecordingRow
from mavcal.service.vehicle.job_vehicle import VehicleSource


def running_campaigns(engine: JobEngine, source: VehicleSource, computations: Computations) -> Campaigns:
    """The campaigns of an engine that has not started; it resumes them with its other jobs."""
    campaigns = Campaigns(engine.book, engine.tasks, time.monotonic, time.time)
    campaigns.works |= _works(engine, source, computations)
    engine.resumed_by[CAMPAIGN] = campaigns.resume_at_start
    return campaigns


def _works(engine: JobEngine, source: VehicleSource, computations: Computations) -> dict[CampaignTask, ItemWork]:
    """What a running service does for each task; diagnoses go one after the other, so that fits find a free child."""
    vehicles, patience = asyncio.Semaphore(VEHICLES_AT_ONCE), Patience(source, engine.settings.return_limit_s)
    return {
        CampaignTask.PREFLIGHT: PreflightWork(engine, patience, vehicles),
        CampaignTask.CALIBRATE: CalibrationWork(engine, patience, vehicles),
        CampaignTask.RESTORE: RestoreWork(engine, patience, vehicles),
        CampaignTask.FIT: UploadFits(computations, asyncio.Semaphore(computations.at_once)),
        CampaignTask.GAP: UploadGaps(computations, asyncio.Semaphore(1)),
    }


@dataclass(frozen=True)
class CalibrationOrder:
    """What a campaign of calibrations is to do."""

    kind: str
    options: Mapping[str, Any]
    plan_options: Mapping[str, Any]
    apply: bool = False
    """Accept every plan without objections."""
    reboot: bool = False
    """Restart a vehicle whose plan needs it; otherwise such a plan stays in review."""
    actor: str = "operator"


@dataclass(frozen=True)
class RestoreOrder:
    """What a campaign that puts calibrations back is to do; fields as those of a calibration."""

    plan_options: Mapping[str, Any]
    apply: bool = False
    reboot: bool = False
    actor: str = "operator"


@dataclass(frozen=True)
class CampaignDesk:
    """Begins campaigns on request. `at_once` bounds the items of one campaign; None: its queue alone does."""

    campaigns: Campaigns
    computations: Computations
    read_only: bool = False
    attended: bool = False
    """A command runs the campaigns of vehicles, and only its `resume` goes on with them."""

    async def preflight(self, vehicles: Sequence[str], *, at_once: int | None = None) -> Job:
        """A preflight of each vehicle, by id. Raises InvalidInputError, CampaignsBusy."""
        return await self._begin(CampaignTask.PREFLIGHT, {}, vehicles, at_once, self.attended)

    async def calibrate(self, vehicles: Sequence[str], order: CalibrationOrder, *, at_once: int | None = None) -> Job:
        """A calibration of each vehicle.

        Raises
        ------
        InvalidInputError
            If the kind or an option is unknown, or a confirmation is given, which belongs to one plan.
        Forbidden
            If plans are to be written and this service never writes.
        CampaignsBusy
        """
        spec = specification(order.kind)
        writing = self._writing(order)
        require_sensors_of(spec, order.plan_options)
        options = {"kind": spec.kind, "options": dict(validate_options(order.kind, order.options)), **writing}
        return await self._begin(CampaignTask.CALIBRATE, options, vehicles, at_once, self.attended)

    async def restore(self, vehicles: Sequence[str], order: RestoreOrder, *, at_once: int | None = None) -> Job:
        """A campaign that restores the last verified calibration of each vehicle. Raises as :meth:`calibrate`."""
        options = self._writing(order)
        return await self._begin(CampaignTask.RESTORE, options, vehicles, at_once, self.attended)

    def _writing(self, order: CalibrationOrder | RestoreOrder) -> dict[str, Any]:
        """The options that a campaign keeps for its plans. Raises InvalidInputError, Forbidden."""
        if order.apply and self.read_only:
            raise Forbidden("this service runs with --read-only and never writes: begin the campaign without apply")
        given = confirmed(order.plan_options)
        if given:
            raise InvalidInputError(f"{given[0]} confirms one plan that a person has seen: accept that plan by itself")
        return {
            "plan_options": checked_plan_options(order.plan_options),
            "apply": order.apply,
            "reboot": order.reboot,
            "actor": order.actor,
        }

    async def fit(
        self,
        uploads: Iterable[RecordingRow],
        wanted: Sequence[str] | None,
        method: str,
        options: Mapping[str, Any],
        *,
        at_once: int | None = None,
    ) -> Job:
        """A method on each upload; `wanted` None: on all of them.

        Raises RecordingUnknown, InvalidInputError, CampaignsBusy.
        """
        require_finite(options)
        order = {"method": method, "options": dict(options)}
        return await self._of_uploads(CampaignTask.FIT, order, uploads, wanted, at_once)

    async def gap(
        self,
        uploads: Iterable[RecordingRow],
        wanted: Sequence[str] | None,
        sim: str | None,
        nominal: Sequence[str],
        *,
        at_once: int | None = None,
    ) -> Job:
        """A diagnosis of each upload; `wanted` None: of all but those that it compares them with.

        Raises RecordingUnknown, InvalidInputError, CampaignsBusy.
        """
        beside = (*(() if sim is None else (sim,)), *nominal)
        for upload in beside:
            self.computations.check(upload)
        order = {"sim": sim, "nominal": list(nominal)}
        others = [row for row in uploads if wanted is not None or row.id not in beside]
        return await self._of_uploads(CampaignTask.GAP, order, others, wanted, at_once)

    async def _of_uploads(
        self,
        task: CampaignTask,
        order: Mapping[str, Any],
        uploads: Iterable[RecordingRow],
        wanted: Sequence[str] | None,
        at_once: int | None,
    ) -> Job:
        names = {row.id: row.name for row in uploads}
        chosen = tuple(names) if wanted is None else wanted
        for upload in chosen[:1] if wanted is None else chosen:
            self.computations.check(upload, order.get("method"))
        return await self._begin(task, order, chosen, at_once, attended=False, names=names)

    async def _begin(
        self,
        task: CampaignTask,
        options: Mapping[str, Any],
        subjects: Sequence[str],
        at_once: int | None,
        attended: bool,
        names: Mapping[str, str] | None = None,
    ) -> Job:
        named = [(subject, (names or {}).get(subject, "")) for subject in subjects]
        chosen = {**options, "at_once": at_once}
        return await self.campaigns.begin(task, chosen, named, attended=attended)
