"""Keeps the records of the fleet: those of ended jobs and preflights, and names and tags given by people."""

from __future__ import annotations

import dataclasses
import time
import uuid
from collections.abc import Callable, Collection, Iterable
from functools import partial

import structlog

from mavcal.service.errors import StoreError, UnitUnknown
from mavcal.service.fleet.records import preflight_row, records_of_job, records_of_preflight, sensor_row
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.preflights import Preflight
from mavcal.service.store.rows import UnitRow
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.registry import VehicleRegistry

log = structlog.get_logger(__name__)

PREFLIGHTS_KEPT = 60
"""Number of preflights of a unit whose readings are kept; no trend uses more."""
_DECIDED = frozenset({JobState.SUCCEEDED, JobState.IN_DOUBT, JobState.ROLLING_BACK, JobState.REVERTED})
"""States of a job whose write is over, or being taken back."""


class FleetBook:
    """Writes the records of units; reading goes directly to the store."""

    def __init__(self, store: Store, vehicles: VehicleRegistry) -> None:
        self._store = store
        self._vehicles = vehicles
        self.measured = 1
        """Grows whenever a sensor was measured here; not 0: what the store has was not looked at yet."""
        self._forget = vehicles.subscribe(self._heard)

    def close(self) -> None:
        """Unsubscribe from vehicles."""
        self._forget()

    def _heard(self, event: VehicleEvent) -> None:
        if event.kind is not VehicleEventKind.IDENTIFIED:
            return
        for vehicle in self._vehicles.all():
            if vehicle.id == event.vehicle_id:
                known = vehicle.identity
                see = partial(self._store.see_unit, vehicle.id, known.autopilot.value, known.version_text)
                self._store.soon(partial(self._kept, partial(see, time.time())))

    # --- jobs and preflights

    async def take_up(self, jobs: Iterable[Job]) -> None:
        """Record the jobs that ended while no service ran; called at every start."""
        known = await self._store.do(self._store.fleet_sources)
        for job in jobs:
            if (job.state == JobState.SUCCEEDED) != (job.id in known):
                self.job_ended(job)

    def job_ended(self, job: Job) -> None:
        """Store the measurements of an ended job, or drop them if its write is taken back or in doubt."""
        if job.vehicle_id is not None and job.plan is not None and job.state in _DECIDED:
            self._store.soon(partial(self._kept, partial(self._take, job)))

    def _take(self, job: Job) -> None:
        self.measured += 1
        if job.state != JobState.SUCCEEDED:
            self._store.drop_sensor_records(job.id)
            return
        rows = [sensor_row(record) for record in records_of_job(job, self._store)]
        self._store.add_sensor_records(job.id, rows)

    def _kept(self, write: Callable[[], None]) -> None:
        """Write a record; a failure does no harm to the job, and is made good at the next start."""
        try:
            write()
        except Exception as error:  # noqa: BLE001 - of any kind: no calibration may suffer from it
            log.error("the fleet's record could not be kept", reason=str(error), kind=type(error).__name__)

    async def keep_preflight(self, found: Preflight) -> Preflight:
        """Store a report as the unit's last one; a failure becomes one of its notes."""
        rows = [sensor_row(r) for r in records_of_preflight(found, f"preflight-{uuid.uuid4().hex[:12]}")]

        def keep() -> None:
            self._store.save_preflight(preflight_row(found))
            self.measured += 1
            if rows:
                self._store.add_sensor_records(rows[0].source_id, rows, keep=PREFLIGHTS_KEPT)

        try:
            await self._store.do(keep)
        except StoreError as error:
            note = f"this report is not in the fleet's record: {error}"
            return dataclasses.replace(found, notes=(*found.notes, note))
        return found

    # --- names and tags

    async def tagged(self, tag: str) -> frozenset[str]:
        """Ids of the units that carry a tag."""
        rows = await self._store.do(self._store.fleet)
        return frozenset(unit.id for unit in rows.units if tag in unit.tags)

    async def rename(self, unit_id: str, *, name: str | None = None, tags: Collection[str] | None = None) -> UnitRow:
        """Give a unit a name or tags; None: as before.

        Raises
        ------
        UnitUnknown
            If nothing is known of such a unit.
        """
        return await self._store.do(partial(renamed, self._store, unit_id, name, tags))


def renamed(store: Store, unit_id: str, name: str | None, tags: Collection[str] | None) -> UnitRow:
    """See :meth:`FleetBook.rename`; in the thread of the caller."""
    found = store.unit(unit_id)
    if found is None:
        content = store.fleet(unit_id)
        if not (content.sensors or content.preflights):
            raise UnitUnknown(f"there is no unit {unit_id}: `mavcal fleet` and GET /api/v1/fleet list them")
        found = UnitRow(unit_id, "", (), "", "", 0.0)
    changed = dataclasses.replace(
        found,
        name=found.name if name is None else name,
        tags=found.tags if tags is None else tuple(sorted(set(tags))),
    )
    store.save_unit(changed)
    return changed
