"""How answers are read, by their shape."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from pydantic import TypeAdapter

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

AUDIT_CHECK: TypeAdapter[AuditCheck] = TypeAdapter(AuditCheck)
AUDIT_PAGE: TypeAdapter[AuditPage] = TypeAdapter(AuditPage)
FITS_MODEL: TypeAdapter[FitsModel] = TypeAdapter(FitsModel)
FLEET_UNIT_MODEL: TypeAdapter[FleetUnitModel] = TypeAdapter(FleetUnitModel)
GAP_MODEL: TypeAdapter[GapModel] = TypeAdapter(GapModel)
GAP_SUMMARY: TypeAdapter[GapSummary] = TypeAdapter(GapSummary)
HEALTH_MODEL: TypeAdapter[HealthModel] = TypeAdapter(HealthModel)
INFO_MODEL: TypeAdapter[InfoModel] = TypeAdapter(InfoModel)
JOB_MESSAGE: TypeAdapter[JobMessage] = TypeAdapter(JobMessage)
JOB_MODEL: TypeAdapter[JobModel] = TypeAdapter(JobModel)
LINK_MODEL: TypeAdapter[LinkModel] = TypeAdapter(LinkModel)
LIVE_MESSAGE: TypeAdapter[LiveMessage] = TypeAdapter(LiveMessage)
MESSAGE: TypeAdapter[Message] = TypeAdapter(Message)
PLAN_MODEL: TypeAdapter[PlanModel] = TypeAdapter(PlanModel)
PREFLIGHT_MODEL: TypeAdapter[PreflightModel] = TypeAdapter(PreflightModel)
READINESS_MODEL: TypeAdapter[ReadinessModel] = TypeAdapter(ReadinessModel)
RECORDING_MODEL: TypeAdapter[RecordingModel] = TypeAdapter(RecordingModel)
REGISTRATION_MODEL: TypeAdapter[RegistrationModel] = TypeAdapter(RegistrationModel)
REVIEW_MODEL: TypeAdapter[ReviewModel] = TypeAdapter(ReviewModel)
SIGNING_KEY_MODEL: TypeAdapter[SigningKeyModel] = TypeAdapter(SigningKeyModel)
TICKET_MODEL: TypeAdapter[TicketModel] = TypeAdapter(TicketModel)
UNFINISHED_MODEL: TypeAdapter[UnfinishedModel] = TypeAdapter(UnfinishedModel)
UNIT_HISTORY_MODEL: TypeAdapter[UnitHistoryModel] = TypeAdapter(UnitHistoryModel)
VEHICLE_MESSAGE: TypeAdapter[VehicleMessage] = TypeAdapter(VehicleMessage)
VEHICLE_MODEL: TypeAdapter[VehicleModel] = TypeAdapter(VehicleModel)
VEHICLE_SENSORS_MODEL: TypeAdapter[VehicleSensorsModel] = TypeAdapter(VehicleSensorsModel)
WATCH_MODEL: TypeAdapter[WatchModel] = TypeAdapter(WatchModel)
FLEET_UNIT_MODEL_LIST: TypeAdapter[list[FleetUnitModel]] = TypeAdapter(list[FleetUnitModel])
GAP_SUMMARY_LIST: TypeAdapter[list[GapSummary]] = TypeAdapter(list[GapSummary])
ITEM_MODEL_LIST: TypeAdapter[list[ItemModel]] = TypeAdapter(list[ItemModel])
JOB_SUMMARY_LIST: TypeAdapter[list[JobSummary]] = TypeAdapter(list[JobSummary])
LINK_MODEL_LIST: TypeAdapter[list[LinkModel]] = TypeAdapter(list[LinkModel])
METHOD_MODEL_LIST: TypeAdapter[list[MethodModel]] = TypeAdapter(list[MethodModel])
PARAMETER_MODEL_LIST: TypeAdapter[list[ParameterModel]] = TypeAdapter(list[ParameterModel])
PROCEDURE_MODEL_LIST: TypeAdapter[list[ProcedureModel]] = TypeAdapter(list[ProcedureModel])
RECORDING_MODEL_LIST: TypeAdapter[list[RecordingModel]] = TypeAdapter(list[RecordingModel])
SERIES_MODEL_LIST: TypeAdapter[list[SeriesModel]] = TypeAdapter(list[SeriesModel])
SIGNING_KEY_MODEL_LIST: TypeAdapter[list[SigningKeyModel]] = TypeAdapter(list[SigningKeyModel])
UNFINISHED_MODEL_LIST: TypeAdapter[list[UnfinishedModel]] = TypeAdapter(list[UnfinishedModel])
VEHICLE_MODEL_LIST: TypeAdapter[list[VehicleModel]] = TypeAdapter(list[VehicleModel])
