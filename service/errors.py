"""Everything that ``service`` raises on purpose.

.. code-block:: text

    ServiceError                  500
    +-- LinkError                 503
    |   +-- LinkDown              503
    |   +-- EndpointError         422
    |   |   +-- EndpointRefused   403
    |   +-- LinkUnknown           404
    |   +-- LinkElsewhere         409
    |   +-- LinkOpen              409
    |   +-- LinkBusy              409
    |   +-- SigningKeyError       409
    |   |   +-- SigningKeyUnknown 404
    |   |   +-- SigningNotConfirmed 503
    |   +-- PortBusy              409
    +-- VehicleError              503
    |   +-- VehicleSilent         503
    |   +-- VehicleUnknown        404
    |   +-- UnitUnknown           404
    |   +-- WatchUnknown          404
    |   +-- NotSimulated          409
    |   +-- HandBusy              409
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
    |   +-- JobElsewhere          409
    |   +-- IllegalTransition     409
    |   +-- PlanChanged           409
    |   +-- NoVehicle             409
    |   +-- DocumentUnknown       404
    |   +-- PhysicalJobRunning    409
    |   +-- PreflightRunning      409
    |   +-- NotCancellable        409
    |   +-- NotRevertible         409
    |   +-- JobCancelled          409
    |   +-- PlanBlocked           409
    |   +-- PlanMissing           404
    |   +-- OtherVehicle          409
    |   +-- NothingVerified       409
    |   +-- ExportUnknown         404
    |   +-- IdempotencyConflict   409
    |   +-- AnswerRefused         409
    |   +-- CaptureEnded          409
    |   |   +-- CaptureDisturbed  409
    |   |   +-- CaptureLost       409
    |   |   +-- CaptureMoved      409
    |   +-- WriteFailed           409
    |   +-- WriteStopped          409
    +-- StoreError                500
    |   +-- DiskFull              507
    |   +-- DataDirLocked         409
    |   +-- LeaseLost             409
    +-- AuthError                 401
    |   +-- Forbidden             403
    |   +-- TooManyAttempts       429   carries how long to wait
    +-- TooManyStreams            503
    +-- UploadError               422
    |   +-- UploadTooLarge        413
    +-- ChildEnded                422
    +-- ChildrenBusy              429
    +-- CampaignsBusy             429
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

from collections.abc import Iterator
from typing import ClassVar


class ServiceError(Exception):
    """Something went wrong inside the service; its log says what."""

    code: ClassVar[str] = "internal-error"
    title: ClassVar[str] = "Internal error"
    status_code: ClassVar[int] = 500

    def __init_subclass__(cls, *, code: str, status: int | None = None, title: str | None = None) -> None:
        """Every error has a code of its own; the status is inherited, the title is the code in words."""
        super().__init_subclass__()
        cls.code, cls.title = code, title or code.replace("-", " ").capitalize()
        cls.status_code = cls.status_code if status is None else status

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__doc__)


def kinds() -> Iterator[type[ServiceError]]:
    """Every class of the tree."""
    pending: list[type[ServiceError]] = [ServiceError]
    while pending:
        kind = pending.pop()
        yield kind
        pending += kind.__subclasses__()


def error_of(code: str, detail: str) -> ServiceError | None:
    """The error with this code and these words; None: no class has the code."""
    for kind in kinds():
        if kind.code == code:
            error = kind.__new__(kind, detail)
            ServiceError.__init__(error, detail)
            return error
    return None


# --- links and vehicles: states, commands, parameters


class LinkError(ServiceError, code="link-error", status=503):
    """The link does not work; see its state for the reason."""


class LinkDown(LinkError, code="link-down"):
    """The link is down; it reconnects by itself once the other side is there again."""


class EndpointError(LinkError, code="endpoint-unknown", status=422, title="Unknown endpoint"):
    """Not an endpoint. Give udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD or file:PATH."""


class EndpointRefused(EndpointError, code="endpoint-refused", status=403, title="Endpoint not allowed"):
    """Not an endpoint that may be opened over the network: `links` in the settings says which may."""


class LinkUnknown(LinkError, code="link-unknown", status=404):
    """No such link. GET /api/v1/links lists them."""


class LinkElsewhere(LinkError, code="link-elsewhere", status=409):
    """Another instance of the service has this link open. Ask that one."""


class LinkOpen(LinkError, code="link-open", status=409, title="Link open with another key"):
    """The link is open and signed with another key. Close it first."""


class LinkBusy(LinkError, code="link-busy", status=409, title="A write needs this link"):
    """A write runs over this link, or is in doubt. Let it end, or open another link to the same vehicle first."""


class SigningKeyError(LinkError, code="signing-key-error", status=409, title="Signing key refused"):
    """The signing key cannot be used like that."""


class SigningKeyUnknown(SigningKeyError, code="signing-key-unknown", status=404):
    """No such signing key. GET /api/v1/signing-keys lists them."""


class SigningNotConfirmed(SigningKeyError, code="signing-not-confirmed", status=503):
    """The vehicle did not confirm the signing key: the link stays unsigned."""


class PortBusy(LinkError, code="port-busy", status=409):
    """Another program uses this port. Stop it, or let it forward to another port and connect to that one."""


class VehicleError(ServiceError, code="vehicle-error", status=503):
    """The vehicle did not do what was asked."""

    sent: int = 0
    """While writing a parameter: how many PARAM_SET had left. With 0 the vehicle cannot have changed by them."""


class VehicleSilent(VehicleError, code="vehicle-silent"):
    """The vehicle is silent: no heartbeat for 3 s. Check its power and the link, then try again."""


class VehicleUnknown(VehicleError, code="vehicle-unknown", status=404):
    """No such vehicle. GET /api/v1/vehicles lists those that were heard."""


class WatchUnknown(VehicleError, code="watch-unknown", status=404):
    """The watch is over, or of another vehicle. POST /api/v1/vehicles/{vehicle_id}/watches begins one."""


class NotSimulated(VehicleError, code="not-simulated", status=409):
    """Only a simulated vehicle is turned from here. Turn this one with your hands."""


class HandBusy(VehicleError, code="hand-busy", status=409, title="Not in your hand"):
    """The simulated vehicle is not in your hand. Choose `mouse` as its hand first."""


class UnitUnknown(VehicleError, code="unit-unknown", status=404):
    """No such unit. GET /api/v1/fleet lists the known ones."""


class VehicleArmed(VehicleError, code="vehicle-armed", status=409):
    """The vehicle is armed, or was a moment ago. Disarm it, on the ground, and wait 2 s."""


class VehicleBusy(VehicleError, code="vehicle-busy", status=409):
    """The vehicle is not ready: it is calibrating by itself, or not known to be on the ground."""


class VehicleConflict(VehicleError, code="vehicle-conflict", status=409):
    """Who is being talked to is not certain: two vehicles share a system id, or somebody else uses our ids."""


class CommandRefused(VehicleError, code="command-refused", status=409):
    """The vehicle refused the command."""

    def __init__(self, message: str | None = None, *, command: int = 0, result: int = 0) -> None:
        super().__init__(message)
        self.command = command
        """MAV_CMD that was refused."""
        self.result = result
        """MAV_RESULT of the answer."""


class CommandTimeout(VehicleError, code="command-timeout", title="Command not acknowledged"):
    """The vehicle did not acknowledge the command; whether it was executed is not known."""


class ForbiddenCommand(VehicleError, code="command-forbidden", status=409):
    """A command that can harm the vehicle or people is never sent by this software."""


class ParameterError(VehicleError, code="parameter-error", status=409):
    """A parameter could not be read or written."""

    def __init__(self, message: str | None = None, *, name: str = "", sent: int = 0) -> None:
        super().__init__(message)
        self.name = name
        """The parameter."""
        self.sent = sent


class ParameterMissing(ParameterError, code="parameter-missing", status=404):
    """The vehicle has no such parameter: it answers, but not to this name."""


class ParameterTimeout(ParameterError, code="parameter-timeout", status=503, title="Parameter not answered"):
    """The vehicle did not answer in time; the value of the parameter is not known."""


class ParameterRejected(ParameterError, code="parameter-rejected"):
    """The vehicle holds another value than the one that was written, or the value cannot be sent."""


# --- what keeps a job from beginning, going on or being written


class JobError(ServiceError, code="job-error", status=409):
    """The job cannot do that."""


class JobUnknown(JobError, code="job-unknown", status=404):
    """No such job. GET /api/v1/jobs lists them."""


class JobElsewhere(JobError, code="job-elsewhere"):
    """The job belongs to another instance of the service. Ask that one."""


class IllegalTransition(JobError, code="illegal-transition"):
    """The job's state does not allow this step."""


class PlanChanged(JobError, code="plan-changed", title="Plan again"):
    """The vehicle or its parameters are no longer what the plan was made for: plan again."""


class NoVehicle(JobError, code="no-vehicle", title="Job of no vehicle"):
    """The job computes something of uploaded files: it has no vehicle to write to."""


class DocumentUnknown(JobError, code="document-unknown", status=404):
    """The job has no document of that name."""


class PhysicalJobRunning(JobError, code="physical-job-running", title="A job is running"):
    """The vehicle has a calibration running; wait for it or cancel it."""


class NotCancellable(JobError, code="not-cancellable"):
    """The job has ended, or is writing: it cannot be cancelled now."""


class JobCancelled(JobError, code="job-cancelled", title="Cancelled"):
    """The job was cancelled while its result was waited for."""


class NotRevertible(JobError, code="not-revertible", title="Nothing to revert"):
    """The job has written nothing that could be taken back."""


class PreflightRunning(JobError, code="preflight-running", title="A preflight is running"):
    """The vehicle is being checked; that takes ten seconds, up to 30 on a slow link."""


class PlanBlocked(JobError, code="plan-blocked"):
    """The plan may not be written: it has blockers."""


class OtherVehicle(JobError, code="other-vehicle", title="Not of this vehicle"):
    """The recording is not of this vehicle's sensors."""


class NothingVerified(JobError, code="nothing-verified"):
    """No verified calibration of this very unit is known here, so there is nothing to restore."""


class PlanMissing(JobError, code="plan-missing", status=404, title="No plan"):
    """The job has no plan."""


class ExportUnknown(JobError, code="export-unknown", status=404):
    """A job is exported as param, parm, params, json, csv or html."""


class IdempotencyConflict(JobError, code="idempotency-key-reused"):
    """The Idempotency-Key was used for another request; use a new one for a new request."""


class AnswerRefused(JobError, code="answer-refused"):
    """The job asks nothing that this would answer."""


class CaptureEnded(JobError, code="capture-ended"):
    """The capture cannot be used."""

    def __init__(self, message: str | None = None, *, remedy: str = "Start the job again.") -> None:
        super().__init__(message)
        self.remedy = remedy
        """What helps."""


class CaptureDisturbed(CaptureEnded, code="capture-disturbed"):
    """The vehicle changed its own calibration while the capture ran."""


class CaptureMoved(CaptureEnded, code="capture-moved"):
    """Another link of the vehicle is in use; the capture goes on there."""


class CaptureLost(CaptureEnded, code="capture-interrupted"):
    """The vehicle was away for too long; what was recorded is kept."""


class WriteFailed(JobError, code="write-failed"):
    """The write did not take effect as planned; what was written is taken back."""


class WriteStopped(JobError, code="write-stopped"):
    """The vehicle is not in a state in which anything may be written: nothing more is sent."""


# --- the host: store, keys, uploads, child processes, diagnoses


class StoreError(ServiceError, code="store-error", title="Storage error"):
    """The data directory cannot be used."""


class DiskFull(StoreError, code="disk-full", status=507):
    """The disk is full: nothing more can be recorded. Free some space; recording goes on by itself."""


class DataDirLocked(StoreError, code="data-dir-locked", status=409, title="Data directory in use"):
    """Another mavcal process uses this data directory. Stop it, or choose another with --data-dir."""


class LeaseLost(StoreError, code="lease-lost", status=409, title="Owned elsewhere"):
    """Another instance of the service owns that now: nothing more is written for it here."""


class AuthError(ServiceError, code="authentication-required", status=401):
    """Give a valid API key."""


class Forbidden(AuthError, code="not-allowed", status=403):
    """The API key does not allow that."""


class TooManyAttempts(AuthError, code="too-many-attempts", status=429):
    """Too many wrong keys came from this address. Wait for the stated time, then use a valid key."""

    def __init__(self, message: str | None = None, *, wait_s: float = 0.0) -> None:
        super().__init__(message)
        self.wait_s = wait_s
        """After which a key is looked at again."""


class TooManyStreams(ServiceError, code="too-many-streams", status=503, title="Too many event streams"):
    """As many event streams are open as the service allows. Close one, or raise `limits.streams` in the settings."""


class UploadError(ServiceError, code="upload-unreadable", status=422):
    """The uploaded file cannot be read as a recording."""


class UploadTooLarge(UploadError, code="upload-too-large", status=413):
    """The uploaded file is larger than this service accepts."""


class ChildEnded(ServiceError, code="file-not-processed", status=422):
    """The file could not be processed: the process that read it ended without a result."""

    def __init__(self, cause: str = "the process that read it ended without a result") -> None:
        super().__init__(f"the file could not be processed: {cause}")
        self.cause = cause
        """Why, to follow a colon."""


class ChildrenBusy(ServiceError, code="files-busy", status=429, title="Too many files"):
    """Too many files are waiting to be read; try again when one is done."""


class RecordingUnknown(ServiceError, code="recording-unknown", status=404):
    """No such recording. GET /api/v1/recordings lists them."""


class GapError(ServiceError, code="gap-error", status=409, title="Gap diagnosis error"):
    """The gap diagnosis cannot do that."""


class GapUnknown(GapError, code="gap-unknown", status=404, title="Gap diagnosis unknown"):
    """No such gap diagnosis. GET /api/v1/gaps lists them."""


class GapUnfinished(GapError, code="gap-unfinished", title="No report"):
    """The gap diagnosis has no report: it is not done, or it failed."""


class GapsBusy(GapError, code="gaps-busy", status=429, title="Too many diagnoses"):
    """Too many gap diagnoses are waiting; try again when one has ended."""


class CampaignsBusy(ServiceError, code="campaigns-busy", status=429, title="Too many campaigns"):
    """Too many campaigns are running; try again when one has ended."""
