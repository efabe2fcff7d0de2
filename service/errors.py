"""Everything that ``service`` raises on purpose.

.. code-block:: text

    ServiceError                  500
    +-- LinkError                 503
    |   +-- LinkDown              503
    |   +-- EndpointError         422
    |   |   +-- EndpointRefused   403
    |   +-- LinkUnknown           404
    |   +-- PortBusy              409
    +-- VehicleError              503
    |   +-- VehicleSilent         503
    |   +-- VehicleUnknown        404
    |   +-- VehicleArmed          409
    |   +-- VehicleBusy           409
    |   +-- VehicleConflict       409
    |   +-- CommandRefused        409   carries the MAV_RESULT
    |   +-- CommandTimeout        503
    |   +-- ForbiddenCommand      409
    |   +-- ParameterError        409
    |       +-- ParameterMissing  404
    |       +-- ParameterTimeout  503
    |       +-- ParameterRejected 409
    +-- JobError                  409
    |   +-- JobUnknown            404
    |   +-- IllegalTransition     409
    |   +-- PlanChanged           409
    |   +-- PhysicalJobRunning    409
    |   +-- NotCancellable        409
    |   +-- NotRevertible         409
    |   +-- PlanBlocked           409
    |   +-- PlanMissing           404
    |   +-- OtherVehicle          409
    |   +-- ExportUnknown         404
    |   +-- IdempotencyConflict   409
    |   +-- AnswerRefused         409
    |   +-- CaptureEnded          409
    |   |   +-- CaptureLost       409
    |   +-- WriteFailed           409
    |   +-- WriteStopped          409
    +-- StoreError                500
    |   +-- DiskFull              507
    |   +-- DataDirLocked         409
    +-- AuthError                 401
    |   +-- Forbidden             403
    |   +-- TooManyAttempts       429   carries how long to wait
    +-- TooManyStreams            503
    +-- UploadError               422
    |   +-- UploadTooLarge        413
    +-- ChildEnded                422
    +-- ChildrenBusy              429
    +-- RecordingUnknown          404
    +-- GapError                  409
        +-- GapUnknown            404
        +-- GapUnfinished         409
        +-- GapsBusy              429

The docstring of a class is its default message; ``status_code``, ``title`` and ``code`` are what the HTTP
interface answers with.
"""

# ruff: noqa: N818 - a name says what happened; "Error" behind each of them would say it again

from __future__ import annotations

from typing import ClassVar


class ServiceError(Exception):
    """Something went wrong inside the service; its log says what."""

    status_code: ClassVar[int] = 500
    title: ClassVar[str] = "Internal error"
    code: ClassVar[str] = "internal-error"

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__doc__)


class LinkError(ServiceError):
    """The link does not work; see its state for the reason."""

    status_code = 503
    title = "Link error"
    code = "link-error"


class LinkDown(LinkError):
    """The link is down; it reconnects by itself once the other side is there again."""

    title = "Link down"
    code = "link-down"


class EndpointError(LinkError):
    """Not an endpoint. Give udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD or file:PATH."""

    status_code = 422
    title = "Unknown endpoint"
    code = "endpoint-unknown"


class EndpointRefused(EndpointError):
    """Not an endpoint that may be opened over the network: `links` in the settings says which may."""

    status_code = 403
    title = "Endpoint not allowed"
    code = "endpoint-refused"


class LinkUnknown(LinkError):
    """No such link. GET /api/v1/links lists them."""

    status_code = 404
    title = "Link unknown"
    code = "link-unknown"


class PortBusy(LinkError):
    """Another program uses this port. Stop it, or let it forward to another port and connect to that one."""

    status_code = 409
    title = "Port busy"
    code = "port-busy"


class VehicleError(ServiceError):
    """The vehicle did not do what was asked."""

    status_code = 503
    title = "Vehicle error"
    code = "vehicle-error"

    sent: int = 0
    """While writing a parameter: how many PARAM_SET had left. With 0 the vehicle cannot have changed by them."""


class VehicleSilent(VehicleError):
    """The vehicle is silent: no heartbeat for 3 s. Check its power and the link, then try again."""

    title = "Vehicle silent"
    code = "vehicle-silent"


class VehicleUnknown(VehicleError):
    """No such vehicle. GET /api/v1/vehicles lists those that were heard."""

    status_code = 404
    title = "Vehicle unknown"
    code = "vehicle-unknown"


class VehicleArmed(VehicleError):
    """The vehicle is armed, or was a moment ago. Disarm it, on the ground, and wait 2 s."""

    status_code = 409
    title = "Vehicle armed"
    code = "vehicle-armed"


class VehicleBusy(VehicleError):
    """The vehicle is not ready: it is calibrating by itself, or not known to be on the ground."""

    status_code = 409
    title = "Vehicle busy"
    code = "vehicle-busy"


class VehicleConflict(VehicleError):
    """Who is being talked to is not certain: two vehicles share a system id, or somebody else uses our ids."""

    status_code = 409
    title = "Vehicle conflict"
    code = "vehicle-conflict"


class CommandRefused(VehicleError):
    """The vehicle refused the command."""

    status_code = 409
    title = "Command refused"
    code = "command-refused"

    def __init__(self, message: str | None = None, *, command: int = 0, result: int = 0) -> None:
        super().__init__(message)
        self.command = command
        """MAV_CMD that was refused."""
        self.result = result
        """MAV_RESULT of the answer."""


class CommandTimeout(VehicleError):
    """The vehicle did not acknowledge the command; whether it was executed is not known."""

    title = "Command not acknowledged"
    code = "command-timeout"


class ForbiddenCommand(VehicleError):
    """A command that can harm the vehicle or people is never sent by this software."""

    status_code = 409
    title = "Command forbidden"
    code = "command-forbidden"


class ParameterError(VehicleError):
    """A parameter could not be read or written."""

    status_code = 409
    title = "Parameter error"
    code = "parameter-error"

    def __init__(self, message: str | None = None, *, name: str = "", sent: int = 0) -> None:
        super().__init__(message)
        self.name = name
        """The parameter."""
        self.sent = sent


class ParameterMissing(ParameterError):
    """The vehicle has no such parameter: it answers, but not to this name."""

    status_code = 404
    title = "Parameter missing"
    code = "parameter-missing"


class ParameterTimeout(ParameterError):
    """The vehicle did not answer in time; the value of the parameter is not known."""

    status_code = 503
    title = "Parameter not answered"
    code = "parameter-timeout"


class ParameterRejected(ParameterError):
    """The vehicle holds another value than the one that was written, or the value cannot be sent."""

    title = "Parameter rejected"
    code = "parameter-rejected"


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


class IllegalTransition(JobError):
    """The job's state does not allow this step."""

    title = "Illegal transition"
    code = "illegal-transition"


class PlanChanged(JobError):
    """The vehicle or its parameters are no longer what the plan was made for: plan again."""

    title = "Plan again"
    code = "plan-changed"


class PhysicalJobRunning(JobError):
    """The vehicle has a calibration running; wait for it or cancel it."""

    title = "A job is running"
    code = "physical-job-running"


class NotCancellable(JobError):
    """The job has ended, or is writing: it cannot be cancelled now."""

    title = "Not cancellable"
    code = "not-cancellable"


class NotRevertible(JobError):
    """The job has written nothing that could be taken back."""

    title = "Nothing to revert"
    code = "not-revertible"


class PlanBlocked(JobError):
    """The plan may not be written: it has blockers."""

    title = "Plan blocked"
    code = "plan-blocked"


class OtherVehicle(JobError):
    """The recording is not of this vehicle's sensors."""

    title = "Not of this vehicle"
    code = "other-vehicle"


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


class StoreError(ServiceError):
    """The data directory cannot be used."""

    title = "Storage error"
    code = "store-error"


class DiskFull(StoreError):
    """The disk is full: nothing more can be recorded. Free some space; recording goes on by itself."""

    status_code = 507
    title = "Disk full"
    code = "disk-full"


class DataDirLocked(StoreError):
    """Another mavcal process uses this data directory. Stop it, or choose another with --data-dir."""

    status_code = 409
    title = "Data directory in use"
    code = "data-dir-locked"


class AuthError(ServiceError):
    """Give a valid API key."""

    status_code = 401
    title = "Authentication required"
    code = "authentication-required"


class Forbidden(AuthError):
    """The API key does not allow that."""

    status_code = 403
    title = "Not allowed"
    code = "not-allowed"


class TooManyAttempts(AuthError):
    """Too many wrong keys came from this address. Wait for the stated time, then use a valid key."""

    status_code = 429
    title = "Too many attempts"
    code = "too-many-attempts"

    def __init__(self, message: str | None = None, *, wait_s: float = 0.0) -> None:
        super().__init__(message)
        self.wait_s = wait_s
        """After which a key is looked at again."""


class TooManyStreams(ServiceError):
    """As many event streams are open as the service allows. Close one, or raise `limits.streams` in the settings."""

    status_code = 503
    title = "Too many event streams"
    code = "too-many-streams"


class UploadError(ServiceError):
    """The uploaded file cannot be read as a recording."""

    status_code = 422
    title = "Upload unreadable"
    code = "upload-unreadable"


class UploadTooLarge(UploadError):
    """The uploaded file is larger than this service accepts."""

    status_code = 413
    title = "Upload too large"
    code = "upload-too-large"


class ChildEnded(ServiceError):
    """The file could not be processed: the process that read it ended without a result."""

    status_code = 422
    title = "File not processed"
    code = "file-not-processed"

    def __init__(self, cause: str = "the process that read it ended without a result") -> None:
        super().__init__(f"the file could not be processed: {cause}")
        self.cause = cause
        """Why, to follow a colon."""


class ChildrenBusy(ServiceError):
    """Too many files are waiting to be read; try again when one is done."""

    status_code = 429
    title = "Too many files"
    code = "files-busy"


class RecordingUnknown(ServiceError):
    """No such recording. GET /api/v1/recordings lists them."""

    status_code = 404
    title = "Recording unknown"
    code = "recording-unknown"


class GapError(ServiceError):
    """The gap diagnosis cannot do that."""

    status_code = 409
    title = "Gap diagnosis error"
    code = "gap-error"


class GapUnknown(GapError):
    """No such gap diagnosis. GET /api/v1/gaps lists them."""

    status_code = 404
    title = "Gap diagnosis unknown"
    code = "gap-unknown"


class GapUnfinished(GapError):
    """The gap diagnosis has no report: it is not done, or it failed."""

    title = "No report"
    code = "gap-unfinished"


class GapsBusy(GapError):
    """Too many gap diagnoses are waiting; try again when one has ended."""

    status_code = 429
    title = "Too many diagnoses"
    code = "gaps-busy"
