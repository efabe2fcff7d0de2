"""The client that waits for nothing: one method for each operation."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from collections.abc import AsyncIterable, AsyncIterator
from typing import Any, Literal

from mavcal.client.base import Number
from mavcal.client.enums import Hand, ItemOutcome, JobState
from mavcal.client.events import JobMessage, LiveMessage, Message, VehicleMessage
from mavcal.client.exchange import segment
from mavcal.client.jobs import JobModel, PlanModel
from mavcal.client.models import (
    AuditCheck,
    AuditPage,
    FitsModel,
    FleetUnitModel,
    GapModel,
    GapSummary,
    HealthModel,
    InfoModel,
    ItemModel,
    JobSummary,
    LinkModel,
    MethodModel,
    ParameterModel,
    PreflightModel,
    ProcedureModel,
    ReadinessModel,
    RecordingModel,
    RegistrationModel,
    ReviewModel,
    SeriesModel,
    SigningKeyModel,
    TicketModel,
    UnfinishedModel,
    UnitHistoryModel,
    VehicleModel,
    VehicleSensorsModel,
    WatchModel,
)
from mavcal.client.requests import PlanOptions, ReadingOptions
from mavcal.client.transport import AsyncTransport


class AsyncClient(AsyncTransport):
    """Asks a service, and waits for nothing."""

    async def list_links(self) -> list[LinkModel]:
        """Every open link."""
        return await self._ask("GET", "/api/v1/links", list[LinkModel])

    async def open_link(self, *, url: str) -> LinkModel:
        """Open a link; one that is open already is returned as it is."""
        return await self._ask("POST", "/api/v1/links", LinkModel, body={"url": url})

    async def get_link(self, link_id: str) -> LinkModel:
        """One link."""
        return await self._ask("GET", f"/api/v1/links/{segment(link_id)}", LinkModel)

    async def close_link(self, link_id: str) -> None:
        """Close a link; its recording stays. Not while a write needs it: 409."""
        await self._text("DELETE", f"/api/v1/links/{segment(link_id)}")

    async def list_signing_keys(self) -> list[SigningKeyModel]:
        """Every signing key by name, without the key."""
        return await self._ask("GET", "/api/v1/signing-keys", list[SigningKeyModel])

    async def add_signing_key(self, *, name: str, key: str | None = None) -> SigningKeyModel:
        """Keep a signing key, or make one."""
        return await self._ask("POST", "/api/v1/signing-keys", SigningKeyModel, body={"name": name, "key": key})

    async def remove_signing_key(self, name: str) -> None:
        """Forget a signing key that no open link uses."""
        await self._text("DELETE", f"/api/v1/signing-keys/{segment(name)}")

    async def set_up_signing(self, link_id: str, *, key: str) -> LinkModel:
        """Give the one vehicle of a link a key (SETUP_SIGNING); the link is signed once the vehicle signs with it."""
        return await self._ask("POST", f"/api/v1/links/{segment(link_id)}/signing", LinkModel, body={"key": key})

    async def list_vehicles(self) -> list[VehicleModel]:
        """Every vehicle that was heard."""
        return await self._ask("GET", "/api/v1/vehicles", list[VehicleModel])

    async def get_vehicle(self, vehicle_id: str) -> VehicleModel:
        """One vehicle."""
        return await self._ask("GET", f"/api/v1/vehicles/{segment(vehicle_id)}", VehicleModel)

    async def list_parameters(self, vehicle_id: str, *, refresh: bool | None = None) -> list[ParameterModel]:
        """Every parameter of the vehicle as heard last; `refresh` lists them again first."""
        return await self._ask(
            "GET",
            f"/api/v1/vehicles/{segment(vehicle_id)}/parameters",
            list[ParameterModel],
            query={"refresh": refresh},
        )

    async def list_sensors(self, vehicle_id: str) -> VehicleSensorsModel:
        """How the calibrations of a vehicle stand, and what it needs now; asks the vehicle for nothing."""
        return await self._ask("GET", f"/api/v1/vehicles/{segment(vehicle_id)}/sensors", VehicleSensorsModel)

    async def choose_hand(self, vehicle_id: str, *, hand: Hand) -> VehicleModel:
        """Say who moves a simulated vehicle: it follows prompts by itself, a person turns it, or it stays as it is."""
        return await self._ask(
            "POST", f"/api/v1/vehicles/{segment(vehicle_id)}/hand", VehicleModel, body={"hand": hand}
        )

    async def turn_vehicle(self, vehicle_id: str, *, attitude: list[Number]) -> VehicleModel:
        """Turn a simulated vehicle whose hand is `mouse`; it gets there within a second or two."""
        return await self._ask(
            "POST", f"/api/v1/vehicles/{segment(vehicle_id)}/turns", VehicleModel, body={"attitude": attitude}
        )

    def follow_vehicle(self, vehicle_id: str) -> AsyncIterator[VehicleMessage]:
        """The vehicle's state, once a second, as long as its link is open."""
        return self._follow(f"/api/v1/vehicles/{segment(vehicle_id)}/stream", VehicleMessage)

    async def watch_vehicle(self, vehicle_id: str, *, rate_hz: Number | None = None) -> WatchModel:
        """Have the vehicle send its samples for as long as `follow_samples` is read with this watch.

        Its former message rates are put back when the last watch is over, at once when it arms, and before a job
        chooses its own. It is asked for nothing while it is armed or silent, or while a job runs.
        """
        return await self._ask(
            "POST", f"/api/v1/vehicles/{segment(vehicle_id)}/watches", WatchModel, body={"rate_hz": rate_hz}
        )

    def follow_samples(self, vehicle_id: str, *, watch: str | None = None) -> AsyncIterator[LiveMessage]:
        """What the sensors read, ten times a second, as the vehicle streams it."""
        return self._follow(f"/api/v1/vehicles/{segment(vehicle_id)}/samples", LiveMessage, query={"watch": watch})

    async def run_preflight(
        self, vehicle_id: str, *, heading: Number | None = None, fix: list[Literal["gyro", "level"]] | None = None
    ) -> PreflightModel:
        """Check a vehicle that stands still, in ten seconds (30 on a slow link).

        409 while it is armed, silent, or has a job running.
        """
        return await self._ask(
            "POST",
            f"/api/v1/vehicles/{segment(vehicle_id)}/preflight",
            PreflightModel,
            body={"heading": heading, "fix": fix},
        )

    async def restore_calibration(
        self, vehicle_id: str, *, only: list[str] | None = None, mark_calibrated: bool | None = None
    ) -> JobModel:
        """Plan to put the last verified calibration of this unit back, mapped by device id; `apply` writes the
        plan.

        409 if no calibration of this very unit was verified here.
        """
        return await self._ask(
            "POST",
            f"/api/v1/vehicles/{segment(vehicle_id)}/restore",
            JobModel,
            body={"only": only, "mark_calibrated": mark_calibrated},
        )

    async def list_procedures(self) -> list[ProcedureModel]:
        """What can be calibrated, what each procedure needs, ends on, writes and cannot represent."""
        return await self._ask("GET", "/api/v1/procedures", list[ProcedureModel])

    async def start_job(
        self,
        vehicle_id: str,
        *,
        kind: str,
        options: dict[str, Number | bool] | None = None,
        plan_options: PlanOptions | None = None,
    ) -> JobModel:
        """Start a calibration; 409 if that vehicle has one running."""
        return await self._ask(
            "POST",
            f"/api/v1/vehicles/{segment(vehicle_id)}/jobs",
            JobModel,
            body={"kind": kind, "options": options, "plan_options": plan_options},
        )

    async def list_jobs(
        self,
        *,
        vehicle_id: str | None = None,
        kind: str | None = None,
        state: JobState | None = None,
        order: Literal["oldest", "newest"] | None = None,
        limit: int | None = None,
        after: str | None = None,
    ) -> list[JobSummary]:
        """Jobs of every kind, a page at a time. A header `Link` with `rel="next"` leads to the next page, if any."""
        return await self._ask(
            "GET",
            "/api/v1/jobs",
            list[JobSummary],
            query={
                "vehicle_id": vehicle_id,
                "kind": kind,
                "state": state,
                "order": order,
                "limit": limit,
                "after": after,
            },
        )

    async def get_job(self, job_id: str) -> JobModel:
        """One job with its results."""
        return await self._ask("GET", f"/api/v1/jobs/{segment(job_id)}", JobModel)

    async def cancel_job(self, job_id: str) -> JobModel:
        """Cancel a job that has not written anything."""
        return await self._ask("DELETE", f"/api/v1/jobs/{segment(job_id)}", JobModel)

    async def answer_job(self, job_id: str, *, value: str) -> JobModel:
        """Answer the prompt of a job."""
        return await self._ask("POST", f"/api/v1/jobs/{segment(job_id)}/answers", JobModel, body={"value": value})

    async def get_plan(self, job_id: str) -> PlanModel:
        """What would be written, why, and what it costs."""
        return await self._ask("GET", f"/api/v1/jobs/{segment(job_id)}/plan", PlanModel)

    async def renew_plan(self, job_id: str, *, plan_options: PlanOptions | None = None) -> PlanModel:
        """Plan again on the vehicle's present parameters: what `apply` asks for when something has changed.

        `plan_options` decide about the plan in place of what was decided before; without them it stays so.
        """
        return await self._ask(
            "POST", f"/api/v1/jobs/{segment(job_id)}/plan", PlanModel, body={"plan_options": plan_options}
        )

    async def refit_job(self, job_id: str) -> JobModel:
        """Fit what an interrupted job has recorded."""
        return await self._ask("POST", f"/api/v1/jobs/{segment(job_id)}/refit", JobModel)

    async def apply_plan(
        self,
        job_id: str,
        *,
        plan_sha256: str,
        idempotency_key: str | None = None,
        reboot: bool | None = None,
        prove_s: Number | None = None,
        preflight: bool | None = None,
    ) -> JobModel:
        """Accept the plan with this digest and write it; 409 if it is no longer the plan to be written.

        A repeated Idempotency-Key answers with the job and writes nothing, unless its write ended before anything
        was sent.
        """
        return await self._ask(
            "POST",
            f"/api/v1/jobs/{segment(job_id)}/apply",
            JobModel,
            header={"idempotency-key": idempotency_key},
            body={"plan_sha256": plan_sha256, "reboot": reboot, "prove_s": prove_s, "preflight": preflight},
        )

    async def revert_job(self, job_id: str) -> JobModel:
        """Take back what a job has written, where it still stands."""
        return await self._ask("POST", f"/api/v1/jobs/{segment(job_id)}/revert", JobModel)

    async def export_job(self, job_id: str, form: Literal["param", "parm", "params", "json", "csv", "html"]) -> str:
        """The result as a file: param, parm, params, json, csv or html."""
        return await self._text("GET", f"/api/v1/jobs/{segment(job_id)}/export.{segment(form)}")

    async def get_document(self, job_id: str, name: str) -> str:
        """A document that the job has made, such as the report of a diagnosis."""
        return await self._text("GET", f"/api/v1/jobs/{segment(job_id)}/documents/{segment(name)}")

    def follow_job(self, job_id: str, *, last_event_id: int | None = None) -> AsyncIterator[JobMessage]:
        """Everything that happens to a job, from its beginning or from Last-Event-ID on."""
        return self._follow(
            f"/api/v1/jobs/{segment(job_id)}/events", JobMessage, last_event_id=last_event_id, resume=True
        )

    def follow_events(self, *, last_event_id: int | None = None) -> AsyncIterator[Message]:
        """Everything that happens: to any job, from now or from Last-Event-ID on, and to vehicles and links.

        Events named `job` have ids and are replayed; `vehicle` and `link` carry the present state as soon as it
        changes.
        """
        return self._follow("/api/v1/events", Message, last_event_id=last_event_id, resume=True)

    async def list_unfinished(self) -> list[UnfinishedModel]:
        """Jobs that earlier runs have left unfinished, oldest first, as they were when this service began."""
        return await self._ask("GET", "/api/v1/unfinished", list[UnfinishedModel])

    async def get_unfinished(self, job_id: str) -> UnfinishedModel:
        """What a job has sent, and what is in doubt now."""
        return await self._ask("GET", f"/api/v1/jobs/{segment(job_id)}/unfinished", UnfinishedModel)

    async def get_review(self, job_id: str) -> ReviewModel:
        """What the plan of a job does, and what speaks for and against it; 409 while there is no plan."""
        return await self._ask("GET", f"/api/v1/jobs/{segment(job_id)}/review", ReviewModel)

    async def get_picture(self, job_id: str, *, columns: int | None = None) -> str:
        """Each sensor before and after the plan; 409 while there is no plan, or nothing of it can be drawn."""
        return await self._text("GET", f"/api/v1/jobs/{segment(job_id)}/picture.svg", query={"columns": columns})

    async def list_recordings(self) -> list[RecordingModel]:
        """Every uploaded recording."""
        return await self._ask("GET", "/api/v1/recordings", list[RecordingModel])

    async def upload_recording(
        self, content: bytes | AsyncIterable[bytes], *, name: str, reading: ReadingOptions | None = None
    ) -> RecordingModel:
        """Upload a recording as the body of the request."""
        return await self._ask(
            "POST", "/api/v1/recordings", RecordingModel, query={"name": name, "reading": reading}, content=content
        )

    async def list_methods(self) -> list[MethodModel]:
        """The methods that fit an uploaded recording."""
        return await self._ask("GET", "/api/v1/methods", list[MethodModel])

    async def get_recording(self, recording_id: str) -> RecordingModel:
        """One uploaded recording, and what is in it."""
        return await self._ask("GET", f"/api/v1/recordings/{segment(recording_id)}", RecordingModel)

    async def list_series(self, recording_id: str) -> list[SeriesModel]:
        """The sensors of an uploaded recording over its time, thinned for a picture."""
        return await self._ask("GET", f"/api/v1/recordings/{segment(recording_id)}/series", list[SeriesModel])

    async def fit_recording(
        self, recording_id: str, *, method: str, options: dict[str, Any] | None = None
    ) -> FitsModel:
        """Run one method on an uploaded recording and wait for it; `POST /fits` does not wait.

        It is a job of kind `fit`, whose address is in Location. It is cancelled when the client goes away.
        """
        return await self._ask(
            "POST",
            f"/api/v1/recordings/{segment(recording_id)}/fits",
            FitsModel,
            body={"method": method, "options": options},
        )

    async def start_fit(self, *, method: str, recording: str, options: dict[str, Any] | None = None) -> JobModel:
        """A job that runs one method on an uploaded recording: followed, cancelled and listed as every other job."""
        return await self._ask(
            "POST", "/api/v1/fits", JobModel, body={"method": method, "options": options, "recording": recording}
        )

    async def plan_recording(
        self,
        recording_id: str,
        *,
        method: str,
        vehicle_id: str,
        options: dict[str, Any] | None = None,
        plan_options: PlanOptions | None = None,
    ) -> JobModel:
        """A job that fits an uploaded recording; then it is in review, or failed if it is not of this vehicle's
        sensors.

        What it plans is accepted, written, proved and taken back as every other job's.
        """
        return await self._ask(
            "POST",
            f"/api/v1/recordings/{segment(recording_id)}/jobs",
            JobModel,
            body={"method": method, "options": options, "vehicle_id": vehicle_id, "plan_options": plan_options},
        )

    async def list_gaps(self) -> list[GapSummary]:
        """Every diagnosis, oldest first, without its report."""
        return await self._ask("GET", "/api/v1/gaps", list[GapSummary])

    async def diagnose_gap(
        self, *, real: str, sim: str | None = None, nominal: list[str] | None = None, limit_s: Number | None = None
    ) -> GapSummary:
        """Diagnose the sim-to-real gap of an uploaded recording; 429 if too many diagnoses are waiting."""
        return await self._ask(
            "POST", "/api/v1/gaps", GapSummary, body={"real": real, "sim": sim, "nominal": nominal, "limit_s": limit_s}
        )

    async def get_gap(self, gap_id: str) -> GapModel:
        """Where a diagnosis stands, and its report once it is done."""
        return await self._ask("GET", f"/api/v1/gaps/{segment(gap_id)}", GapModel)

    async def get_gap_report(self, gap_id: str) -> str:
        """The report as a page; 409 while there is none."""
        return await self._text("GET", f"/api/v1/gaps/{segment(gap_id)}/report.html")

    async def list_fleet(
        self,
        *,
        order: Literal["name", "verdict", "age", "leaving", "seen"] | None = None,
        descending: bool | None = None,
        limit: int | None = None,
        after: str | None = None,
        verdict: list[Literal["pass", "warn", "fail", "unknown", "none"]] | None = None,
        tag: str | None = None,
        min_age_days: Number | None = None,
        sensor: str | None = None,
        needs_recalibration: bool | None = None,
        odd: bool | None = None,
    ) -> list[FleetUnitModel]:
        """Every known unit, a page at a time.

        A header `Link` with `rel="next"` leads to the next page, if any.
        """
        return await self._ask(
            "GET",
            "/api/v1/fleet",
            list[FleetUnitModel],
            query={
                "order": order,
                "descending": descending,
                "limit": limit,
                "after": after,
                "verdict": verdict,
                "tag": tag,
                "min_age_days": min_age_days,
                "sensor": sensor,
                "needs_recalibration": needs_recalibration,
                "odd": odd,
            },
        )

    async def export_fleet(
        self,
        *,
        order: Literal["name", "verdict", "age", "leaving", "seen"] | None = None,
        descending: bool | None = None,
        verdict: list[Literal["pass", "warn", "fail", "unknown", "none"]] | None = None,
        tag: str | None = None,
        min_age_days: Number | None = None,
        sensor: str | None = None,
        needs_recalibration: bool | None = None,
        odd: bool | None = None,
    ) -> str:
        """The same as a table, one row a unit, all of them."""
        return await self._text(
            "GET",
            "/api/v1/fleet.csv",
            query={
                "order": order,
                "descending": descending,
                "verdict": verdict,
                "tag": tag,
                "min_age_days": min_age_days,
                "sensor": sensor,
                "needs_recalibration": needs_recalibration,
                "odd": odd,
            },
        )

    async def get_unit(self, unit_id: str) -> FleetUnitModel:
        """One unit."""
        return await self._ask("GET", f"/api/v1/fleet/{segment(unit_id)}", FleetUnitModel)

    async def change_unit(
        self, unit_id: str, *, name: str | None = None, tags: list[str] | None = None
    ) -> FleetUnitModel:
        """Give a unit a name, tags, or both; they stay with its hardware id."""
        return await self._ask(
            "PATCH", f"/api/v1/fleet/{segment(unit_id)}", FleetUnitModel, body={"name": name, "tags": tags}
        )

    async def get_unit_history(self, unit_id: str) -> UnitHistoryModel:
        """Every calibration of each sensor with its numbers, and what preflights read, oldest first."""
        return await self._ask("GET", f"/api/v1/fleet/{segment(unit_id)}/history", UnitHistoryModel)

    async def start_preflight_campaign(
        self, *, vehicles: list[str] | Literal["all"], at_once: int | None = None, tag: str | None = None
    ) -> JobModel:
        """Check many vehicles as one job. A vehicle that is armed, silent or busy is skipped, and its item says so."""
        return await self._ask(
            "POST", "/api/v1/campaigns/preflight", JobModel, body={"at_once": at_once, "vehicles": vehicles, "tag": tag}
        )

    async def start_calibration_campaign(
        self,
        *,
        vehicles: list[str] | Literal["all"],
        kind: str,
        at_once: int | None = None,
        tag: str | None = None,
        plan_options: PlanOptions | None = None,
        apply: bool | None = None,
        reboot: bool | None = None,
        options: dict[str, Number | bool] | None = None,
    ) -> JobModel:
        """Calibrate many vehicles as one job, which begins a job for each. Without `apply` their plans wait in
        review.
        """
        return await self._ask(
            "POST",
            "/api/v1/campaigns/calibrate",
            JobModel,
            body={
                "at_once": at_once,
                "vehicles": vehicles,
                "tag": tag,
                "plan_options": plan_options,
                "apply": apply,
                "reboot": reboot,
                "kind": kind,
                "options": options,
            },
        )

    async def start_restore_campaign(
        self,
        *,
        vehicles: list[str] | Literal["all"],
        at_once: int | None = None,
        tag: str | None = None,
        plan_options: PlanOptions | None = None,
        apply: bool | None = None,
        reboot: bool | None = None,
    ) -> JobModel:
        """Put the last verified calibration of many vehicles back as a job; without `apply` their plans wait in
        review.
        """
        return await self._ask(
            "POST",
            "/api/v1/campaigns/restore",
            JobModel,
            body={
                "at_once": at_once,
                "vehicles": vehicles,
                "tag": tag,
                "plan_options": plan_options,
                "apply": apply,
                "reboot": reboot,
            },
        )

    async def start_fit_campaign(
        self,
        *,
        recordings: list[str] | Literal["all"],
        method: str,
        at_once: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> JobModel:
        """Run one method on many uploads as one job; the fits are in its items."""
        return await self._ask(
            "POST",
            "/api/v1/campaigns/fit",
            JobModel,
            body={"at_once": at_once, "recordings": recordings, "method": method, "options": options},
        )

    async def start_gap_campaign(
        self,
        *,
        recordings: list[str] | Literal["all"],
        at_once: int | None = None,
        sim: str | None = None,
        nominal: list[str] | None = None,
    ) -> JobModel:
        """Diagnose the sim-to-real gap of many uploads as one job; the reports are documents of its items."""
        return await self._ask(
            "POST",
            "/api/v1/campaigns/gap",
            JobModel,
            body={"at_once": at_once, "recordings": recordings, "sim": sim, "nominal": nominal},
        )

    async def resume_campaign(self, job_id: str) -> JobModel:
        """Go on with a campaign that was interrupted; what has ended is not done again."""
        return await self._ask("POST", f"/api/v1/campaigns/{segment(job_id)}/resume", JobModel)

    async def interrupt_campaign(self, job_id: str) -> JobModel:
        """Stop a running campaign so that it can be resumed; jobs that it has begun go on."""
        return await self._ask("POST", f"/api/v1/campaigns/{segment(job_id)}/interrupt", JobModel)

    async def list_items(
        self,
        job_id: str,
        *,
        outcome: list[ItemOutcome] | None = None,
        after: int | None = None,
        limit: int | None = None,
    ) -> list[ItemModel]:
        """Items of a campaign, a page at a time; other jobs have none. A header `Link` leads to the next page, if
        any.
        """
        return await self._ask(
            "GET",
            f"/api/v1/jobs/{segment(job_id)}/items",
            list[ItemModel],
            query={"outcome": outcome, "after": after, "limit": limit},
        )

    async def export_items(self, job_id: str, form: Literal["csv"], *, outcome: list[ItemOutcome] | None = None) -> str:
        """The outcome of a campaign as a table: one line an item."""
        return await self._text(
            "GET", f"/api/v1/jobs/{segment(job_id)}/items.{segment(form)}", query={"outcome": outcome}
        )

    async def get_health(self) -> HealthModel:
        """Whether the process answers."""
        return await self._ask("GET", "/healthz", HealthModel)

    async def get_readiness(self) -> ReadinessModel:
        """Whether jobs can be run: the store takes writes and nothing stands in the way."""
        return await self._ask("GET", "/readyz", ReadinessModel, also=(503,))

    async def get_metrics(self) -> str:
        """Counters in the format of Prometheus."""
        return await self._text("GET", "/metrics")

    async def get_info(self) -> InfoModel:
        """Name and versions."""
        return await self._ask("GET", "/info", InfoModel)

    async def get_registration(self) -> RegistrationModel:
        """How BlueOS lists the service."""
        return await self._ask("GET", "/register_service", RegistrationModel)

    async def explain_problem(self, code: str) -> str:
        """What a problem code means; the `type` of a problem document leads here."""
        return await self._text("GET", f"/problems/{segment(code)}", also=(404,))

    async def make_ticket(self) -> TicketModel:
        """Make a ticket for one event stream.

        A browser's EventSource cannot send headers: give it `?ticket=...` instead.
        """
        return await self._ask("POST", "/api/v1/tickets", TicketModel)

    async def list_audit(self, *, after: int | None = None, limit: int | None = None) -> AuditPage:
        """Who asked for what, oldest first, a page at a time."""
        return await self._ask("GET", "/api/v1/audit", AuditPage, query={"after": after, "limit": limit})

    async def check_audit(self) -> AuditCheck:
        """Check the hash chain of the audit trail."""
        return await self._ask("GET", "/api/v1/audit/check", AuditCheck)
