"""Decides what an API key that is bound to tags may see, for every route and stream.

A vehicle is seen by such a key if one of its tags is one of the key's. Jobs are seen with their vehicle, links with one
that is on them. Uploads and what is computed of them have no vehicle and are not seen. What is not seen answers as if
it were not there. A route without a `{…}` in its path that is not among :data:`FILTERED` is refused.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

from mavcal.service.api.models.vehicles import LinkModel
from mavcal.service.core import Service
from mavcal.service.errors import (
    Forbidden,
    GapUnknown,
    JobUnknown,
    LinkUnknown,
    RecordingUnknown,
    ServiceError,
    UnitUnknown,
    VehicleUnknown,
)
from mavcal.service.jobs.core.model import Job

FILTERED: Final = frozenset(
    {
        *("list_vehicles", "list_jobs", "list_links", "list_gaps", "list_recordings", "list_fleet", "export_fleet"),
        *("list_unfinished", "follow_events", "list_procedures", "get_info", "make_ticket"),
    }
)
"""Operations without a `{…}` in their path that leave out what is not seen, or tell of no vehicle."""
_ABSENT: Final[Mapping[str, tuple[type[ServiceError], str]]] = {
    "vehicle_id": (VehicleUnknown, "vehicle"),
    "unit_id": (UnitUnknown, "unit"),
    "job_id": (JobUnknown, "job"),
    "gap_id": (GapUnknown, "gap diagnosis"),
    "recording_id": (RecordingUnknown, "recording"),
    "link_id": (LinkUnknown, "link"),
}


class Sight:
    """The objects that one key may see; `tags` empty: all."""

    def __init__(self, service: Service, tags: Collection[str] = ()) -> None:
        self._service = service
        self._tags = frozenset(tags)

    @property
    def everything(self) -> bool:
        """Whether the key is bound to no tag."""
        return not self._tags

    def tagged(self, tags: Collection[str]) -> bool:
        """Whether a unit with these tags is seen."""
        return self.everything or not self._tags.isdisjoint(tags)

    def vehicle(self, vehicle_id: str | None) -> bool:
        """Whether a vehicle, or the unit of that name, is seen; None: what has no vehicle."""
        if self.everything:
            return True
        if vehicle_id is None:
            return False
        row = self._service.store.unit(self._unit_of(vehicle_id))
        return row is not None and self.tagged(row.tags)

    def _unit_of(self, vehicle_id: str) -> str:
        """Id of a vehicle's unit; the vehicle may still be addressed by the place where it was heard first."""
        try:
            return self._service.vehicles.get(vehicle_id).id
        except VehicleUnknown:
            return vehicle_id

    def job(self, job: Job) -> bool:
        """Whether a job is seen: with its vehicle."""
        return self.vehicle(job.vehicle_id)

    def job_of(self, job_id: str) -> bool:
        """Whether a job of that id is seen; False where there is none."""
        if self.everything:
            return True
        try:
            return self.job(self._service.jobs.get(job_id))
        except JobUnknown:
            return False

    def link(self, model: LinkModel) -> LinkModel | None:
        """The link with those of its vehicles that are seen; None: there are none."""
        if self.everything:
            return model
        seen = [vehicle_id for vehicle_id in model.vehicles if self.vehicle(vehicle_id)]
        return model.model_copy(update={"vehicles": seen}) if seen else None

    def require(self, operation: str, method: str, names: Mapping[str, str]) -> None:
        """Refuse a request whose address names something that is not seen.

        Raises
        ------
        VehicleUnknown, UnitUnknown, JobUnknown, GapUnknown, RecordingUnknown, LinkUnknown
            As if it were not there.
        Forbidden
            If the operation is not for keys that are bound to tags.
        """
        if self.everything:
            return
        known = [(kind, names[kind]) for kind in _ABSENT if kind in names]
        for kind, name in known:
            if not self._seen(kind, name):
                error, what = _ABSENT[kind]
                raise error(f"there is no {what} {name}")
        if not known and operation not in FILTERED:
            raise Forbidden("this key is bound to tags and may not do that: ask with one that is not")
        if "link_id" in names and method not in ("GET", "HEAD"):
            raise Forbidden("this key is bound to tags, and others may be on this link: ask with one that is not")

    def _seen(self, kind: str, name: str) -> bool:
        if kind in ("vehicle_id", "unit_id"):
            return self.vehicle(name)
        if kind in ("job_id", "gap_id"):
            return self.job_of(name)
        if kind == "link_id":
            return any(
                name in [link.id for link in v.links] and self.vehicle(v.id) for v in self._service.vehicles.all()
            )
        return False
