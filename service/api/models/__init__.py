"""What goes over HTTP: dataclasses of the domain as they are (`wire`), and a model where the two differ.

A comment in such a model says in what. `views` makes the models.
"""

from __future__ import annotations

from mavcal.service.api.models.campaigns import (
    CalibrationCampaignRequest,
    FitCampaignRequest,
    GapCampaignRequest,
    ItemModel,
    PreflightCampaignRequest,
    RestoreCampaignRequest,
)
from mavcal.service.api.models.events import JobEvent, Message
from mavcal.service.api.models.fits import FitJobRequest, FitModel, FitRequest, FitsModel
from mavcal.service.api.models.fleet import FleetUnitModel, SensorRecordModel, UnitHistoryModel, UnitRequest
from mavcal.service.api.models.gaps import GapModel, GapRequest, GapSummary
from mavcal.service.api.models.host import (
    AuditCheck,
    AuditPage,
    HealthModel,
    InfoModel,
    ReadinessModel,
    RegistrationModel,
    TicketModel,
)
from mavcal.service.api.models.jobs import (
    AnswerRequest,
    JobModel,
    JobRequest,
    JobSummary,
    UnfinishedModel,
    WriteFailedModel,
    WriteModel,
)
from mavcal.service.api.models.links import LinkModel, LinkRequest, SigningKeyModel, SigningKeyRequest, SigningRequest
from mavcal.service.api.models.live import LiveMessage, LiveModel, SamplesModel, WatchModel, WatchRequest
from mavcal.service.api.models.plans import ApplyRequest, PlanModel, PlanOptions, PlanRequest, VerificationModel
from mavcal.service.api.models.preflight import CheckModel, PreflightModel, PreflightRequest, RestoreRequest
from mavcal.service.api.models.recordings import (
    MethodModel,
    ReadingOptions,
    RecordingJobRequest,
    RecordingModel,
    SeriesModel,
)
from mavcal.service.api.models.reviews import MountingChoiceModel, ReviewModel, SensorEffectModel
from mavcal.service.api.models.steps import OptionModel, ProcedureModel, ProgressModel, PromptModel
from mavcal.service.api.models.vehicles import (
    HandRequest,
    ParameterModel,
    TurnRequest,
    VehicleModel,
    VehicleSensorsModel,
)

__all__ = [
    "AnswerRequest",
    "ApplyRequest",
    "AuditCheck",
    "AuditPage",
    "CalibrationCampaignRequest",
    "CheckModel",
    "FitCampaignRequest",
    "FitJobRequest",
    "FitModel",
    "FitRequest",
    "FitsModel",
    "FleetUnitModel",
    "GapCampaignRequest",
    "GapModel",
    "GapRequest",
    "GapSummary",
    "HandRequest",
    "HealthModel",
    "InfoModel",
    "ItemModel",
    "JobEvent",
    "JobModel",
    "JobRequest",
    "JobSummary",
    "LinkModel",
    "LinkRequest",
    "LiveMessage",
    "LiveModel",
    "Message",
    "MethodModel",
    "MountingChoiceModel",
    "OptionModel",
    "ParameterModel",
    "PlanModel",
    "PlanOptions",
    "PlanRequest",
    "PreflightCampaignRequest",
    "PreflightModel",
    "PreflightRequest",
    "ProcedureModel",
    "ProgressModel",
    "PromptModel",
    "ReadinessModel",
    "ReadingOptions",
    "RecordingJobRequest",
    "RecordingModel",
    "RegistrationModel",
    "RestoreCampaignRequest",
    "RestoreRequest",
    "ReviewModel",
    "SamplesModel",
    "SensorEffectModel",
    "SensorRecordModel",
    "SeriesModel",
    "SigningKeyModel",
    "SigningKeyRequest",
    "SigningRequest",
    "TicketModel",
    "TurnRequest",
    "UnfinishedModel",
    "UnitHistoryModel",
    "UnitRequest",
    "VehicleModel",
    "VehicleSensorsModel",
    "VerificationModel",
    "WatchModel",
    "WatchRequest",
    "WriteFailedModel",
    "WriteModel",
]
