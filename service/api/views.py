"""Wire models from domain objects, and nothing else."""

from __future__ import annotations

import dataclasses
from typing import Any

from mavcal.calib.procedures.spec import ProcedureSpec
from mavcal.calib.report import fit_to_json, plain, plan_to_json, step_to_json, verification_to_json
from mavcal.service.api.models import (
    GapModel,
    GapSummary,
    JobModel,
    JobSummary,
    LinkModel,
    ParameterModel,
    ProcedureModel,
    RecordingModel,
    VehicleModel,
)
from mavcal.service.gaps import GapRow
from mavcal.service.jobs.codec import attempt_to_json, outcome_to_json
from mavcal.service.jobs.model import Job
from mavcal.service.link import Link
from mavcal.service.store.rows import EventRow, RecordingRow
from mavcal.service.vehicle.encoding import Parameter
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.vehicle import Vehicle

Json = dict[str, Any]


def job_summary(job: Job) -> JobSummary:
    """A job for a list."""
    return JobSummary(**_summary(job))


def job_model(job: Job) -> JobModel:
    """A job with its results."""
    return JobModel(
        **_summary(job),
        options=dict(job.options),
        plan_options=plain(job.context.get("plan_options", {})),
        warnings=list(job.warnings),
        results=[fit_to_json(fit) for fit in job.results],
        plan=None if job.plan is None else plan_to_json(job.plan),
        verification=None if job.verification is None else verification_to_json(job.verification),
        standing=[plain(s) for s in job.standing],
        segments=[{**plain(dataclasses.asdict(s) | {"path": s.path.name})} for s in job.segments],
    )


def event_model(event: EventRow) -> Json:
    """An event of a job."""
    return {
        "job_id": event.job_id,
        "sequence": event.sequence,
        "at": event.at,
        "kind": event.kind,
        "data": plain(event.data),
    }


def link_model(link: Link, vehicles: VehicleRegistry) -> LinkModel:
    """A link and who was heard on it."""
    return LinkModel(
        id=link.id,
        url=str(link.endpoint),
        state=link.state.value,
        reason=link.reason,
        vehicles=[v.id for v in vehicles.all() if v.link is link],
        crc_errors=link.crc_errors,
    )


def vehicle_model(vehicle: Vehicle) -> VehicleModel:
    """A vehicle in one page."""
    now = vehicle.clock()
    state, identity, writable = vehicle.state, vehicle.identity, vehicle.writable()
    counted = vehicle.link.statistics(vehicle.system, vehicle.component)
    return VehicleModel(
        id=vehicle.id,
        link=vehicle.link.id,
        system=vehicle.system,
        component=vehicle.component,
        autopilot=identity.autopilot.value,
        firmware=identity.version_text,
        uid=identity.uid2,
        armed=bool(state.armed),
        landed=state.landed.value,
        silent=state.silent(now),
        writable=writable.ok,
        obstacles=list(writable.reasons),
        evidence=list(state.evidence(now)),
        texts=[text.text for text in state.texts[-10:]],
        received=counted.received,
        lost=counted.lost,
        loss=counted.loss,
        bytes_per_s=counted.bytes_per_s,
        parameters_known=len(vehicle.parameters),
    )


def parameter_model(parameter: Parameter) -> ParameterModel:
    """A parameter as the vehicle states it; a value that is not finite is null."""
    return ParameterModel(name=parameter.name, value=plain(parameter.value), kind=parameter.kind.name.lower())


def procedure_model(spec: ProcedureSpec) -> ProcedureModel:
    """A procedure as a row of the table."""
    return ProcedureModel(**plain({k: v for k, v in vars(spec).items() if k != "aliases"}))


def recording_model(row: RecordingRow) -> RecordingModel:
    """An uploaded recording; one whose record on the disk is damaged shows nothing of what is in it."""
    inspection = row.body.get("inspection")
    return RecordingModel(
        id=row.id,
        href=f"api/v1/recordings/{row.id}",
        name=row.name,
        size=row.size,
        sha256=row.sha256,
        uploaded_at=row.at,
        inspection=plain(inspection) if isinstance(inspection, dict) else {},
    )


def gap_summary(row: GapRow) -> GapSummary:
    """A gap diagnosis without its report."""
    return GapSummary(**_gap(row))


def gap_model(row: GapRow, report: Json | None) -> GapModel:
    """A gap diagnosis with its report."""
    done = report is not None
    return GapModel(**_gap(row), report=report, page=f"api/v1/gaps/{row.id}/report.html" if done else None)


def _gap(row: GapRow) -> Json:
    fields = dataclasses.asdict(row)
    return {**fields, "nominal": list(row.nominal), "state": row.state.value, "href": f"api/v1/gaps/{row.id}"}


def _summary(job: Job) -> Json:
    return {
        "id": job.id,
        "href": f"api/v1/jobs/{job.id}",
        "vehicle_id": job.vehicle_id,
        "kind": job.kind,
        "state": job.state.value,
        "created_at": job.created_at,
        "updated_at": job.updated_at,
        "progress": None if job.progress is None else step_to_json(job.progress),
        "prompt": None if job.prompt is None else step_to_json(job.prompt),
        "outcome": plain(outcome_to_json(job.outcome)),
        "last_write": plain(attempt_to_json(job.last_write)),
    }
