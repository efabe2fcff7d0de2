"""Wire models from domain objects."""

from __future__ import annotations

import json
from collections.abc import Sequence

from fastapi import Response

from mavcal.calib.firmware.plan import ParameterKind, Verification, WritePlan
from mavcal.calib.preflight.states import SensorState, summary
from mavcal.calib.procedures.protocol import Prompt
from mavcal.calib.procedures.spec import ProcedureSpec
from mavcal.calib.review.effect import text_of
from mavcal.service.api.models.campaigns import ItemModel
from mavcal.service.api.models.gaps import GapModel, GapSummary
from mavcal.service.api.models.jobs import JobModel, JobSummary, UnfinishedModel
from mavcal.service.api.models.plans import MountingChoiceModel, PlanModel, ReviewModel, SensorEffectModel
from mavcal.service.api.models.preflight import PreflightModel
from mavcal.service.api.models.recordings import RecordingModel
from mavcal.service.api.models.steps import OptionModel, ProcedureModel
from mavcal.service.api.models.vehicles import LinkModel, ParameterModel, VehicleModel, VehicleSensorsModel
from mavcal.service.campaigns.items import Item
from mavcal.service.fixing import Fix
from mavcal.service.jobs.core.codec import Json, from_json, to_json
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.readiness import readiness_of
from mavcal.service.link.link import Link
from mavcal.service.preflights import Preflight
from mavcal.service.reviews import Review
from mavcal.service.store.rows import EventRow, JobDocument, RecordingRow
from mavcal.service.unfinished import Unfinished, beginning, ending
from mavcal.service.vehicle.parameter_bits import Parameter
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.vehicle import Vehicle


def job_summary(job: Job) -> JobSummary:
    """A job for a list."""
    return JobSummary.model_validate(_summary(job))


def job_model(job: Job) -> JobModel:
    """A job with its results."""
    return JobModel.model_validate(
        _summary(job)
        | {
            "plan_options": to_json(job.context.get("plan_options", {})),
            "warnings": list(job.warnings),
            "results": to_json(job.results),
            "plan": None if job.plan is None else _plan(job.plan),
            "verification": None if job.verification is None else _verification(job.verification),
            "readiness": readiness_of(job),
            "standing": job.standing,
            "documents": [
                {"name": name, "href": f"api/v1/jobs/{job.id}/documents/{name}"}
                for name in job.context.get("documents", ())
            ],
            "segments": [{**to_json(s), "path": s.path.name} for s in job.segments],
        }
    )


def unfinished_model(found: Unfinished) -> UnfinishedModel:
    """The unfinished work of an interrupted job."""
    return UnfinishedModel.model_validate(
        {
            "job": _summary(found.job),
            "at": found.at,
            "writing": found.writing,
            "ended": found.ended,
            "sent": [sent.name for sent in found.sent],
            "standing": found.standing,
            "beginning": beginning(found),
            "ending": ending(found),
        }
    )


def sensors_model(states: Sequence[SensorState]) -> VehicleSensorsModel:
    """How the calibrations of a vehicle stand."""
    verdict, text = summary(states)
    return VehicleSensorsModel(verdict=verdict, summary=text, sensors=list(states))


def plan_model(plan: WritePlan) -> PlanModel:
    """A plan."""
    return PlanModel.model_validate(_plan(plan))


def _plan(plan: WritePlan) -> Json:
    return {**vars(plan), "needs_reboot": plan.needs_reboot, "sha256": plan.sha256}


def _verification(check: Verification) -> Json:
    return {**to_json(check), **vars(check)}


def _prompt(prompt: Prompt) -> Json:
    return {**to_json(prompt), "number": prompt.number, "tilts": prompt.tilts, "silence": prompt.silence}


def review_model(job: Job, review: Review) -> ReviewModel:
    """The review of a plan."""
    return ReviewModel(
        headline=review.headline,
        sensors=[
            SensorEffectModel(
                sensor=effect.sensor,
                instance=effect.instance,
                quantity=effect.quantity,
                unit=effect.unit,
                before=effect.before,
                after=effect.after,
                text=text_of(effect, done=job.state == JobState.SUCCEEDED),
            )
            for effect in review.effects
        ],
        criteria=list(review.criteria),
        picture=None if review.picture is None else f"api/v1/jobs/{job.id}/picture.svg",
        mountings=list(review.mountings),
        mounting_choices=[
            MountingChoiceModel(number=choice.number, text=choice.text, matrix=choice.matrix.tolist())
            for choice in review.mounting_choices
        ],
    )


_PROMPT: Json = {"taken": False, "tilts": [], "unfinished": "", "silence": None}
"""Fields that older prompts lack; these are replayed to clients that ask for old events."""


def event_model(event: EventRow) -> Json:
    """An event of a job."""
    earlier: Json = _PROMPT if event.kind == "prompt" and event.data else {}
    return {
        "job_id": event.job_id,
        "sequence": event.sequence,
        "at": event.at,
        "kind": event.kind,
        "data": {**earlier, **to_json(event.data)},
    }


def link_model(link: Link, vehicles: VehicleRegistry) -> LinkModel:
    """A link and who was heard on it."""
    return LinkModel(
        id=link.id,
        url=str(link.endpoint),
        state=link.state,
        reason=link.reason,
        signing_key=link.signing_key,
        vehicles=[v.id for v in vehicles.all() if link in v.links],
        crc_errors=link.crc_errors,
    )


def vehicle_model(vehicle: Vehicle) -> VehicleModel:
    """A vehicle in one page."""
    now = vehicle.clock()
    state, identity, writable = vehicle.state, vehicle.identity, vehicle.writable()
    counted = vehicle.link.statistics(vehicle.system, vehicle.component)
    return VehicleModel(
        id=vehicle.id,
        link=vehicle.way,
        links=[link.id for link in vehicle.links],
        system=vehicle.system,
        component=vehicle.component,
        autopilot=identity.autopilot,
        airframe=identity.airframe,
        firmware=identity.version_text,
        uid=identity.uid2,
        armed=bool(state.armed),
        landed=state.landed,
        silent=vehicle.silent,
        writable=writable.ok,
        obstacles=list(writable.reasons),
        evidence=list(state.evidence(now)),
        texts=[text.text for text in state.texts[-10:]],
        received=counted.received,
        lost=counted.lost,
        loss=counted.loss,
        bytes_per_s=counted.bytes_per_s,
        hand=vehicle.link.hand,
        parameters_known=len(vehicle.parameters),
    )


def parameter_model(parameter: Parameter) -> ParameterModel:
    """A parameter as the vehicle states it; a value that is not finite is null."""
    return ParameterModel(
        name=parameter.name, value=to_json(parameter.value), kind=ParameterKind(parameter.kind.name.lower())
    )


def procedure_model(spec: ProcedureSpec) -> ProcedureModel:
    """A procedure as a row of the table."""
    fields = {name: getattr(spec, name) for name in ProcedureModel.model_fields}
    fields["options"] = [{name: getattr(option, name) for name in OptionModel.model_fields} for option in spec.options]
    return ProcedureModel.model_validate(to_json(fields))


def preflight_model(found: Preflight, fixed: Sequence[Fix]) -> PreflightModel:
    """A preflight, and what was calibrated before it."""
    return PreflightModel.model_validate(
        {
            "vehicle_id": found.vehicle_id,
            "at": found.at,
            "seconds": found.seconds,
            "verdict": found.report.verdict,
            "summary": found.report.summary,
            "checks": found.report.checks,
            "notes": list(found.notes),
            "fixed": to_json(fixed),
        }
    )


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
        inspection=to_json(inspection) if isinstance(inspection, dict) else {},
    )


def item_model(item: Item, campaign_id: str, job: Job | None) -> ItemModel:
    """An item of a campaign, and where the job stands that was begun for it; None: there is none (any more)."""
    result = item.result or {}
    found = result.get("preflight")
    href = f"api/v1/jobs/{campaign_id}/documents"
    return ItemModel.model_validate(
        {name: getattr(item, name) for name in ("number", "subject", "name", "outcome", "code", "text")}
        | {
            "job_id": item.job_id if job is None else job.id,
            "job_state": None if job is None else job.state,
            "began_at": item.began_at,
            "ended_at": item.ended_at,
            "preflight": None if found is None else preflight_model(from_json(found, Preflight), ()),
            "fits": result.get("fits", []),
            "documents": [{"name": name, "href": f"{href}/{name}"} for name in result.get("documents", ())],
        }
    )


def gap_summary(job: Job) -> GapSummary:
    """A gap diagnosis without its report."""
    return GapSummary(**_gap(job))


def gap_model(job: Job, report: JobDocument | None) -> GapModel:
    """A gap diagnosis with its report; None: there is none (yet)."""
    page = None if report is None else f"api/v1/gaps/{job.id}/report.html"
    return GapModel(**_gap(job), report=None if report is None else json.loads(report.body), page=page)


def document_response(document: JobDocument) -> Response:
    """A document as the answer to a request."""
    return Response(document.body, media_type=document.media_type)


def _gap(job: Job) -> Json:
    return {
        "id": job.id,
        "href": f"api/v1/gaps/{job.id}",
        "state": job.state,
        "error": job.outcome.cause if isinstance(job.outcome, Failure) else None,
        "created_at": job.created_at,
        "real": job.options.get("real", ""),
        "sim": job.options.get("sim"),
        "nominal": list(job.options.get("nominal", ())),
    }


def _summary(job: Job) -> Json:
    return {
        "id": job.id,
        "href": f"api/v1/jobs/{job.id}",
        "vehicle_id": job.vehicle_id,
        "kind": job.kind,
        "state": job.state.value,
        "created_at": job.created_at,
        "updated_at": job.updated_at,
        "progress": to_json(job.progress),
        "prompt": None if job.prompt is None else _prompt(job.prompt),
        "outcome": to_json(job.outcome),
        "left_out": job.left_out,
        "broken": job.broken,
        "last_write": job.last_write,
        "options": dict(job.options),
    }
