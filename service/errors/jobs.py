"""What keeps a job from beginning, going on or being written."""

# ruff: noqa: N818 - a name says what happened; "Error" behind each of them would say it again

from __future__ import annotations

from mavcal.service.errors.base import ServiceError


class JobError(ServiceError):
    """The job cannot do that."""

    status_code = 409
    title = "Job error"
    code = "job-error"


class JobUnknown(JobError):
    """No such job. GET /api/v1/jobs lists them."""

    status_code = 404
    title = "Job unknown"
    code = "job-unknown"


class JobElsewhere(JobError):
    """The job belongs to another instance of the service. Ask that one."""

    title = "Job elsewhere"
    code = "job-elsewhere"


class IllegalTransition(JobError):
    """The job's state does not allow this step."""

    title = "Illegal transition"
    code = "illegal-transition"


class PlanChanged(JobError):
    """The vehicle or its parameters are no longer what the plan was made for: plan again."""

    title = "Plan again"
    code = "plan-changed"


class NoVehicle(JobError):
    """The job computes something of uploaded files: it has no vehicle to write to."""

    title = "Job of no vehicle"
    code = "no-vehicle"


class DocumentUnknown(JobError):
    """The job has no document of that name."""

    status_code = 404
    title = "Document unknown"
    code = "document-unknown"


class PhysicalJobRunning(JobError):
    """The vehicle has a calibration running; wait for it or cancel it."""

    title = "A job is running"
    code = "physical-job-running"


class NotCancellable(JobError):
    """The job has ended, or is writing: it cannot be cancelled now."""

    title = "Not cancellable"
    code = "not-cancellable"


class JobCancelled(JobError):
    """The job was cancelled while its result was waited for."""

    title = "Cancelled"
    code = "job-cancelled"


class NotRevertible(JobError):
    """The job has written nothing that could be taken back."""

    title = "Nothing to revert"
    code = "not-revertible"


class PreflightRunning(JobError):
    """The vehicle is being checked; that takes ten seconds, up to 30 on a slow link."""

    title = "A preflight is running"
    code = "preflight-running"


class PlanBlocked(JobError):
    """The plan may not be written: it has blockers."""

    title = "Plan blocked"
    code = "plan-blocked"


class OtherVehicle(JobError):
    """The recording is not of this vehicle's sensors."""

    title = "Not of this vehicle"
    code = "other-vehicle"


class NothingVerified(JobError):
    """No verified calibration of this very unit is known here, so there is nothing to restore."""

    title = "Nothing verified"
    code = "nothing-verified"


class PlanMissing(JobError):
    """The job has no plan."""

    status_code = 404
    title = "No plan"
    code = "plan-missing"


class ExportUnknown(JobError):
    """A job is exported as param, parm, params, json, csv or html."""

    status_code = 404
    title = "Export unknown"
    code = "export-unknown"


class IdempotencyConflict(JobError):
    """The Idempotency-Key was used for another request; use a new one for a new request."""

    title = "Idempotency key reused"
    code = "idempotency-key-reused"


class AnswerRefused(JobError):
    """The job asks nothing that this would answer."""

    title = "Answer refused"
    code = "answer-refused"


class CaptureEnded(JobError):
    """The capture cannot be used."""

    title = "Capture ended"
    code = "capture-ended"

    def __init__(self, message: str | None = None, *, remedy: str = "Start the job again.") -> None:
        super().__init__(message)
        self.remedy = remedy
        """What helps."""


class CaptureDisturbed(CaptureEnded):
    """The vehicle changed its own calibration while the capture ran."""

    title = "Capture disturbed"
    code = "capture-disturbed"


class CaptureMoved(CaptureEnded):
    """Another link of the vehicle is in use; the capture goes on there."""

    title = "Capture moved"
    code = "capture-moved"


class CaptureLost(CaptureEnded):
    """The vehicle was away for too long; what was recorded is kept."""

    title = "Capture interrupted"
    code = "capture-interrupted"


class WriteFailed(JobError):
    """The write did not take effect as planned; what was written is taken back."""

    title = "Write failed"
    code = "write-failed"


class WriteStopped(JobError):
    """The vehicle is not in a state in which anything may be written: nothing more is sent."""

    title = "Write stopped"
    code = "write-stopped"
