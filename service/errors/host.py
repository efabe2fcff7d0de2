"""What goes wrong on the host: store, keys, uploads, child processes, diagnoses."""

# ruff: noqa: N818 - a name says what happened; "Error" behind each of them would say it again

from __future__ import annotations

from mavcal.service.errors.base import ServiceError


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


class LeaseLost(StoreError):
    """Another instance of the service owns that now: nothing more is written for it here."""

    status_code = 409
    title = "Owned elsewhere"
    code = "lease-lost"


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


class CampaignsBusy(ServiceError):
    """Too many campaigns are running; try again when one has ended."""

    status_code = 429
    title = "Too many campaigns"
    code = "campaigns-busy"
