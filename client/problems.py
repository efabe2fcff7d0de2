"""An exception for each problem that the service answers with."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from collections.abc import Mapping

from mavcal.client.errors import ApiProblem


class AnswerRefused(ApiProblem):
    """Answer refused (409). The job asks nothing that this would answer."""


class AuthenticationRequired(ApiProblem):
    """Authentication required (401). Give a valid API key."""


class CampaignsBusy(ApiProblem):
    """Too many campaigns (429). Too many campaigns are running; try again when one has ended."""


class CaptureDisturbed(ApiProblem):
    """Capture disturbed (409). The vehicle changed its own calibration while the capture ran."""


class CaptureEnded(ApiProblem):
    """Capture ended (409). The capture cannot be used."""


class CaptureInterrupted(ApiProblem):
    """Capture interrupted (409). The vehicle was away for too long; what was recorded is kept."""


class CaptureMoved(ApiProblem):
    """Capture moved (409). Another link of the vehicle is in use; the capture goes on there."""


class CommandForbidden(ApiProblem):
    """Command forbidden (409). A command that can harm the vehicle or people is never sent by this software."""


class CommandRefused(ApiProblem):
    """Command refused (409). The vehicle refused the command."""


class CommandTimeout(ApiProblem):
    """Command not acknowledged (503). The vehicle did not acknowledge the command; whether it was executed is not
    known.
    """


class DataDirLocked(ApiProblem):
    """Data directory in use (409). Another mavcal process uses this data directory. Stop it, or choose another with
    --data-dir.
    """


class DiskFull(ApiProblem):
    """Disk full (507). The disk is full: nothing more can be recorded. Free some space; recording goes on by
    itself.
    """


class DocumentUnknown(ApiProblem):
    """Document unknown (404). The job has no document of that name."""


class EndpointRefused(ApiProblem):
    """Endpoint not allowed (403). Not an endpoint that may be opened over the network: `links` in the settings says
    which may.
    """


class EndpointUnknown(ApiProblem):
    """Unknown endpoint (422). Not an endpoint. Give udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT,
    serial:DEVICE:BAUD or file:PATH.
    """


class ExportUnknown(ApiProblem):
    """Export unknown (404). A job is exported as param, parm, params, json, csv or html."""


class FileNotProcessed(ApiProblem):
    """File not processed (422). The file could not be processed: the process that read it ended without a result."""


class FilesBusy(ApiProblem):
    """Too many files (429). Too many files are waiting to be read; try again when one is done."""


class GapError(ApiProblem):
    """Gap diagnosis error (409). The gap diagnosis cannot do that."""


class GapUnfinished(ApiProblem):
    """No report (409). The gap diagnosis has no report: it is not done, or it failed."""


class GapUnknown(ApiProblem):
    """Gap diagnosis unknown (404). No such gap diagnosis. GET /api/v1/gaps lists them."""


class GapsBusy(ApiProblem):
    """Too many diagnoses (429). Too many gap diagnoses are waiting; try again when one has ended."""


class HandBusy(ApiProblem):
    """Not in your hand (409). The simulated vehicle is not in your hand. Choose `mouse` as its hand first."""


class Http(ApiProblem):
    """The request cannot be handled: its method, form or size is not what this address takes."""


class IdempotencyKeyReused(ApiProblem):
    """Idempotency key reused (409). The Idempotency-Key was used for another request; use a new one for a new
    request.
    """


class IllegalTransition(ApiProblem):
    """Illegal transition (409). The job's state does not allow this step."""


class InternalError(ApiProblem):
    """Internal error (500). Something went wrong inside the service; its log says what."""


class InvalidInput(ApiProblem):
    """Invalid input (422). The calibration could not be computed."""


class JobCancelled(ApiProblem):
    """Cancelled (409). The job was cancelled while its result was waited for."""


class JobElsewhere(ApiProblem):
    """Job elsewhere (409). The job belongs to another instance of the service. Ask that one."""


class JobError(ApiProblem):
    """Job error (409). The job cannot do that."""


class JobUnknown(ApiProblem):
    """Job unknown (404). No such job. GET /api/v1/jobs lists them."""


class LeaseLost(ApiProblem):
    """Owned elsewhere (409). Another instance of the service owns that now: nothing more is written for it here."""


class LinkBusy(ApiProblem):
    """A write needs this link (409). A write runs over this link, or is in doubt. Let it end, or open another link
    to the same vehicle first.
    """


class LinkDown(ApiProblem):
    """Link down (503). The link is down; it reconnects by itself once the other side is there again."""


class LinkElsewhere(ApiProblem):
    """Link elsewhere (409). Another instance of the service has this link open. Ask that one."""


class LinkError(ApiProblem):
    """Link error (503). The link does not work; see its state for the reason."""


class LinkOpen(ApiProblem):
    """Link open with another key (409). The link is open and signed with another key. Close it first."""


class LinkUnknown(ApiProblem):
    """Link unknown (404). No such link. GET /api/v1/links lists them."""


class NoVehicle(ApiProblem):
    """Job of no vehicle (409). The job computes something of uploaded files: it has no vehicle to write to."""


class NotAllowed(ApiProblem):
    """Not allowed (403). The API key does not allow that."""


class NotCancellable(ApiProblem):
    """Not cancellable (409). The job has ended, or is writing: it cannot be cancelled now."""


class NotFound(ApiProblem):
    """Not found (404). There is nothing at this address."""


class NotRevertible(ApiProblem):
    """Nothing to revert (409). The job has written nothing that could be taken back."""


class NotSimulated(ApiProblem):
    """Not simulated (409). Only a simulated vehicle is turned from here. Turn this one with your hands."""


class NothingVerified(ApiProblem):
    """Nothing verified (409). No verified calibration of this very unit is known here, so there is nothing to
    restore.
    """


class OtherVehicle(ApiProblem):
    """Not of this vehicle (409). The recording is not of this vehicle's sensors."""


class ParameterError(ApiProblem):
    """Parameter error (409). A parameter could not be read or written."""


class ParameterMissing(ApiProblem):
    """Parameter missing (404). The vehicle has no such parameter: it answers, but not to this name."""


class ParameterRejected(ApiProblem):
    """Parameter rejected (409). The vehicle holds another value than the one that was written, or the value cannot
    be sent.
    """


class ParameterTimeout(ApiProblem):
    """Parameter not answered (503). The vehicle did not answer in time; the value of the parameter is not known."""


class PhysicalJobRunning(ApiProblem):
    """A job is running (409). The vehicle has a calibration running; wait for it or cancel it."""


class PlanBlocked(ApiProblem):
    """Plan blocked (409). The plan may not be written: it has blockers."""


class PlanChanged(ApiProblem):
    """Plan again (409). The vehicle or its parameters are no longer what the plan was made for: plan again."""


class PlanMissing(ApiProblem):
    """No plan (404). The job has no plan."""


class PortBusy(ApiProblem):
    """Port busy (409). Another program uses this port. Stop it, or let it forward to another port and connect to
    that one.
    """


class PreflightRunning(ApiProblem):
    """A preflight is running (409). The vehicle is being checked; that takes ten seconds, up to 30 on a slow link."""


class RecordingUnknown(ApiProblem):
    """Recording unknown (404). No such recording. GET /api/v1/recordings lists them."""


class SigningKeyError(ApiProblem):
    """Signing key refused (409). The signing key cannot be used like that."""


class SigningKeyUnknown(ApiProblem):
    """Signing key unknown (404). No such signing key. GET /api/v1/signing-keys lists them."""


class SigningNotConfirmed(ApiProblem):
    """Signing not confirmed (503). The vehicle did not confirm the signing key: the link stays unsigned."""


class StoreError(ApiProblem):
    """Storage error (500). The data directory cannot be used."""


class TooManyAttempts(ApiProblem):
    """Too many attempts (429). Too many wrong keys came from this address. Wait for the stated time, then use a
    valid key.
    """


class TooManyStreams(ApiProblem):
    """Too many event streams (503). As many event streams are open as the service allows. Close one, or raise
    `limits.streams` in the settings.
    """


class UnitUnknown(ApiProblem):
    """Unit unknown (404). No such unit. GET /api/v1/fleet lists the known ones."""


class UploadTooLarge(ApiProblem):
    """Upload too large (413). The uploaded file is larger than this service accepts."""


class UploadUnreadable(ApiProblem):
    """Upload unreadable (422). The uploaded file cannot be read as a recording."""


class Validation(ApiProblem):
    """Invalid request (422). The request does not have the documented form."""


class VehicleArmed(ApiProblem):
    """Vehicle armed (409). The vehicle is armed, or was a moment ago. Disarm it, on the ground, and wait 2 s."""


class VehicleBusy(ApiProblem):
    """Vehicle busy (409). The vehicle is not ready: it is calibrating by itself, or not known to be on the ground."""


class VehicleConflict(ApiProblem):
    """Vehicle conflict (409). Who is being talked to is not certain: two vehicles share a system id, or somebody
    else uses our ids.
    """


class VehicleError(ApiProblem):
    """Vehicle error (503). The vehicle did not do what was asked."""


class VehicleSilent(ApiProblem):
    """Vehicle silent (503). The vehicle is silent: no heartbeat for 3 s. Check its power and the link, then try
    again.
    """


class VehicleUnknown(ApiProblem):
    """Vehicle unknown (404). No such vehicle. GET /api/v1/vehicles lists those that were heard."""


class WatchUnknown(ApiProblem):
    """Watch unknown (404). The watch is over, or of another vehicle. POST /api/v1/vehicles/{vehicle_id}/watches
    begins one.
    """


class WriteFailed(ApiProblem):
    """Write failed (409). The write did not take effect as planned; what was written is taken back."""


class WriteStopped(ApiProblem):
    """Write stopped (409). The vehicle is not in a state in which anything may be written: nothing more is sent."""


PROBLEMS: Mapping[str, type[ApiProblem]] = {
    "answer-refused": AnswerRefused,
    "authentication-required": AuthenticationRequired,
    "campaigns-busy": CampaignsBusy,
    "capture-disturbed": CaptureDisturbed,
    "capture-ended": CaptureEnded,
    "capture-interrupted": CaptureInterrupted,
    "capture-moved": CaptureMoved,
    "command-forbidden": CommandForbidden,
    "command-refused": CommandRefused,
    "command-timeout": CommandTimeout,
    "data-dir-locked": DataDirLocked,
    "disk-full": DiskFull,
    "document-unknown": DocumentUnknown,
    "endpoint-refused": EndpointRefused,
    "endpoint-unknown": EndpointUnknown,
    "export-unknown": ExportUnknown,
    "file-not-processed": FileNotProcessed,
    "files-busy": FilesBusy,
    "gap-error": GapError,
    "gap-unfinished": GapUnfinished,
    "gap-unknown": GapUnknown,
    "gaps-busy": GapsBusy,
    "hand-busy": HandBusy,
    "http": Http,
    "idempotency-key-reused": IdempotencyKeyReused,
    "illegal-transition": IllegalTransition,
    "internal-error": InternalError,
    "invalid-input": InvalidInput,
    "job-cancelled": JobCancelled,
    "job-elsewhere": JobElsewhere,
    "job-error": JobError,
    "job-unknown": JobUnknown,
    "lease-lost": LeaseLost,
    "link-busy": LinkBusy,
    "link-down": LinkDown,
    "link-elsewhere": LinkElsewhere,
    "link-error": LinkError,
    "link-open": LinkOpen,
    "link-unknown": LinkUnknown,
    "no-vehicle": NoVehicle,
    "not-allowed": NotAllowed,
    "not-cancellable": NotCancellable,
    "not-found": NotFound,
    "not-revertible": NotRevertible,
    "not-simulated": NotSimulated,
    "nothing-verified": NothingVerified,
    "other-vehicle": OtherVehicle,
    "parameter-error": ParameterError,
    "parameter-missing": ParameterMissing,
    "parameter-rejected": ParameterRejected,
    "parameter-timeout": ParameterTimeout,
    "physical-job-running": PhysicalJobRunning,
    "plan-blocked": PlanBlocked,
    "plan-changed": PlanChanged,
    "plan-missing": PlanMissing,
    "port-busy": PortBusy,
    "preflight-running": PreflightRunning,
    "recording-unknown": RecordingUnknown,
    "signing-key-error": SigningKeyError,
    "signing-key-unknown": SigningKeyUnknown,
    "signing-not-confirmed": SigningNotConfirmed,
    "store-error": StoreError,
    "too-many-attempts": TooManyAttempts,
    "too-many-streams": TooManyStreams,
    "unit-unknown": UnitUnknown,
    "upload-too-large": UploadTooLarge,
    "upload-unreadable": UploadUnreadable,
    "validation": Validation,
    "vehicle-armed": VehicleArmed,
    "vehicle-busy": VehicleBusy,
    "vehicle-conflict": VehicleConflict,
    "vehicle-error": VehicleError,
    "vehicle-silent": VehicleSilent,
    "vehicle-unknown": VehicleUnknown,
    "watch-unknown": WatchUnknown,
    "write-failed": WriteFailed,
    "write-stopped": WriteStopped,
}
"""Each by its code."""
