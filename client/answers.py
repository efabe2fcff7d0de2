"""How answers are read, by their shape."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from mavcal.client.base import Reader
from mavcal.client.events import JobMessage, LiveMessage, Message, VehicleMessage
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

AUDIT_CHECK: Reader[AuditCheck] = Reader(AuditCheck)
AUDIT_PAGE: Reader[AuditPage] = Reader(AuditPage)
FITS_MODEL: Reader[FitsModel] = Reader(FitsModel)
FLEET_UNIT_MODEL: Reader[FleetUnitModel] = Reader(FleetUnitModel)
GAP_MODEL: Reader[GapModel] = Reader(GapModel)
GAP_SUMMARY: Reader[GapSummary] = Reader(GapSummary)
HEALTH_MODEL: Reader[HealthModel] = Reader(HealthModel)
INFO_MODEL: Reader[InfoModel] = Reader(InfoModel)
JOB_MESSAGE: Reader[JobMessage] = Reader(JobMessage)
JOB_MODEL: Reader[JobModel] = Reader(JobModel)
LINK_MODEL: Reader[LinkModel] = Reader(LinkModel)
LIVE_MESSAGE: Reader[LiveMessage] = Reader(LiveMessage)
MESSAGE: Reader[Message] = Reader(Message)
PLAN_MODEL: Reader[PlanModel] = Reader(PlanModel)
PREFLIGHT_MODEL: Reader[PreflightModel] = Reader(PreflightModel)
READINESS_MODEL: Reader[ReadinessModel] = Reader(ReadinessModel)
RECORDING_MODEL: Reader[RecordingModel] = Reader(RecordingModel)
REGISTRATION_MODEL: Reader[RegistrationModel] = Reader(RegistrationModel)
REVIEW_MODEL: Reader[ReviewModel] = Reader(ReviewModel)
SIGNING_KEY_MODEL: Reader[SigningKeyModel] = Reader(SigningKeyModel)
TICKET_MODEL: Reader[TicketModel] = Reader(TicketModel)
UNFINISHED_MODEL: Reader[UnfinishedModel] = Reader(UnfinishedModel)
UNIT_HISTORY_MODEL: Reader[UnitHistoryModel] = Reader(UnitHistoryModel)
VEHICLE_MESSAGE: Reader[VehicleMessage] = Reader(VehicleMessage)
VEHICLE_MODEL: Reader[VehicleModel] = Reader(VehicleModel)
VEHICLE_SENSORS_MODEL: Reader[VehicleSensorsModel] = Reader(VehicleSensorsModel)
WATCH_MODEL: Reader[WatchModel] = Reader(WatchModel)
FLEET_UNIT_MODEL_LIST: Reader[list[FleetUnitModel]] = Reader(list[FleetUnitModel])
GAP_SUMMARY_LIST: Reader[list[GapSummary]] = Reader(list[GapSummary])
ITEM_MODEL_LIST: Reader[list[ItemModel]] = Reader(list[ItemModel])
JOB_SUMMARY_LIST: Reader[list[JobSummary]] = Reader(list[JobSummary])
LINK_MODEL_LIST: Reader[list[LinkModel]] = Reader(list[LinkModel])
METHOD_MODEL_LIST: Reader[list[MethodModel]] = Reader(list[MethodModel])
PARAMETER_MODEL_LIST: Reader[list[ParameterModel]] = Reader(list[ParameterModel])
PROCEDURE_MODEL_LIST: Reader[list[ProcedureModel]] = Reader(list[ProcedureModel])
RECORDING_MODEL_LIST: Reader[list[RecordingModel]] = Reader(list[RecordingModel])
SERIES_MODEL_LIST: Reader[list[SeriesModel]] = Reader(list[SeriesModel])
SIGNING_KEY_MODEL_LIST: Reader[list[SigningKeyModel]] = Reader(list[SigningKeyModel])
UNFINISHED_MODEL_LIST: Reader[list[UnfinishedModel]] = Reader(list[UnfinishedModel])
VEHICLE_MODEL_LIST: Reader[list[VehicleModel]] = Reader(list[VehicleModel])
