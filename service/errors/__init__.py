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

from __future__ import annotations

from mavcal.service.errors.base import (
    ServiceError,
)
from mavcal.service.errors.host import (
    AuthError,
    CampaignsBusy,
    ChildEnded,
    ChildrenBusy,
    DataDirLocked,
    DiskFull,
    Forbidden,
    GapError,
    GapsBusy,
    GapUnfinished,
    GapUnknown,
    LeaseLost,
    RecordingUnknown,
    StoreError,
    TooManyAttempts,
    TooManyStreams,
    UploadError,
    UploadTooLarge,
)
from mavcal.service.errors.jobs import (
    AnswerRefused,
    CaptureDisturbed,
    CaptureEnded,
    CaptureLost,
    CaptureMoved,
    DocumentUnknown,
    ExportUnknown,
    IdempotencyConflict,
    IllegalTransition,
    JobCancelled,
    JobElsewhere,
    JobError,
    JobUnknown,
    NotCancellable,
    NothingVerified,
    NotRevertible,
    NoVehicle,
    OtherVehicle,
    PhysicalJobRunning,
    PlanBlocked,
    PlanChanged,
    PlanMissing,
    PreflightRunning,
    WriteFailed,
    WriteStopped,
)
from mavcal.service.errors.vehicles import (
    CommandRefused,
    CommandTimeout,
    EndpointError,
    EndpointRefused,
    ForbiddenCommand,
    HandBusy,
    LinkBusy,
    LinkDown,
    LinkElsewhere,
    LinkError,
    LinkOpen,
    LinkUnknown,
    NotSimulated,
    ParameterError,
    ParameterMissing,
    ParameterRejected,
    ParameterTimeout,
    PortBusy,
    SigningKeyError,
    SigningKeyUnknown,
    SigningNotConfirmed,
    UnitUnknown,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleError,
    VehicleSilent,
    VehicleUnknown,
    WatchUnknown,
)

__all__ = [
    "AnswerRefused",
    "AuthError",
    "CampaignsBusy",
    "CaptureDisturbed",
    "CaptureEnded",
    "CaptureLost",
    "CaptureMoved",
    "ChildEnded",
    "ChildrenBusy",
    "CommandRefused",
    "CommandTimeout",
    "DataDirLocked",
    "DiskFull",
    "DocumentUnknown",
    "EndpointError",
    "EndpointRefused",
    "ExportUnknown",
    "Forbidden",
    "ForbiddenCommand",
    "GapError",
    "GapUnfinished",
    "GapUnknown",
    "GapsBusy",
    "HandBusy",
    "IdempotencyConflict",
    "IllegalTransition",
    "JobCancelled",
    "JobElsewhere",
    "JobError",
    "JobUnknown",
    "LeaseLost",
    "LinkBusy",
    "LinkDown",
    "LinkElsewhere",
    "LinkError",
    "LinkOpen",
    "LinkUnknown",
    "NoVehicle",
    "NotCancellable",
    "NotRevertible",
    "NotSimulated",
    "NothingVerified",
    "OtherVehicle",
    "ParameterError",
    "ParameterMissing",
    "ParameterRejected",
    "ParameterTimeout",
    "PhysicalJobRunning",
    "PlanBlocked",
    "PlanChanged",
    "PlanMissing",
    "PortBusy",
    "PreflightRunning",
    "RecordingUnknown",
    "ServiceError",
    "SigningKeyError",
    "SigningKeyUnknown",
    "SigningNotConfirmed",
    "StoreError",
    "TooManyAttempts",
    "TooManyStreams",
    "UnitUnknown",
    "UploadError",
    "UploadTooLarge",
    "VehicleArmed",
    "VehicleBusy",
    "VehicleConflict",
    "VehicleError",
    "VehicleSilent",
    "VehicleUnknown",
    "WatchUnknown",
    "WriteFailed",
    "WriteStopped",
]
