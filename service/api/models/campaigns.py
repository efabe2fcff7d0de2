"""Campaigns: requests for many vehicles or uploads, and the outcome of each."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from mavcal.service.api.models.fits import FitModel
from mavcal.service.api.models.fleet import Tag
from mavcal.service.api.models.jobs import DocumentModel
from mavcal.service.api.models.plans import PlanOptions
from mavcal.service.api.models.preflight import PreflightModel
from mavcal.service.api.models.wire import Json, Request, Stamp
from mavcal.service.campaigns.campaigns import MOST_ITEMS
from mavcal.service.campaigns.items import ItemOutcome
from mavcal.service.jobs.core.states import JobState

Ids = Annotated[list[Annotated[str, Field(max_length=100)]], Field(min_length=1, max_length=MOST_ITEMS)]
VEHICLES = "ids of `/vehicles`, or `all` that are heard now"
UPLOADS = "ids of `/recordings`, or `all` that are there now"


class _Campaign(Request):
    at_once: int | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="most items of this campaign at a time; null: its queue alone bounds it",
    )


class _VehicleCampaign(_Campaign):
    vehicles: Ids | Literal["all"] = Field(description=VEHICLES)
    tag: Tag | None = Field(default=None, description="only those that carry this tag; null: whatever they carry")


class PreflightCampaignRequest(_VehicleCampaign):
    """Check many vehicles."""


class RestoreCampaignRequest(_VehicleCampaign):
    """Put the last verified calibration of many vehicles back."""

    plan_options: PlanOptions = Field(
        default_factory=PlanOptions,
        description="options of every plan; confirmations belong to one plan and are refused",
    )
    apply: bool = Field(
        default=False,
        description="accept and write every plan that nothing stands against; needs the scope write-params",
    )
    reboot: bool = Field(
        default=False, description="with `apply`: restart a vehicle whose plan needs it; else that plan stays in review"
    )


class CalibrationCampaignRequest(RestoreCampaignRequest):
    """Calibrate many vehicles."""

    kind: str = Field(description="a kind of `/procedures`, such as gyro or level", examples=["gyro"])
    options: dict[str, float | bool] = Field(default_factory=dict, description="options of that procedure")


class FitCampaignRequest(_Campaign):
    """Fit many uploads."""

    recordings: Ids | Literal["all"] = Field(description=UPLOADS)
    method: str = Field(description="a method of `mavcal fit --help`", examples=["mag-ellipsoid"])
    options: Json = Field(default_factory=dict, description="options of that method")


class GapCampaignRequest(_Campaign):
    """Diagnose the sim-to-real gap of many uploads."""

    recordings: Ids | Literal["all"] = Field(description=f"{UPLOADS}, without `sim` and `nominal`")
    sim: str | None = Field(default=None, description="id of a simulator's recording, for all of them")
    nominal: list[str] = Field(default_factory=list, max_length=8, description="ids of recordings without an effect")


class ItemModel(BaseModel):
    """One vehicle or upload of a campaign."""

    # An Item with the state of its job; its result is taken apart.
    number: int = Field(description="its place in the campaign, from 1")
    subject: str = Field(description="id of the vehicle or upload; for a campaign of a command, the file")
    name: str = Field(description="file name of an upload; empty otherwise")
    outcome: ItemOutcome
    code: str = Field(
        description="the outcome in one word: a problem code, the verdict of a preflight or a diagnosis, or the "
        "state of the job when the item ended"
    )
    text: str
    job_id: str | None = Field(description="the job that was begun for it; null: it needed none")
    job_state: JobState | None = Field(
        description="the present state of that job; null: there is none, or not any more"
    )
    began_at: Stamp | None = Field(description="s since 1970; null: not yet")
    ended_at: Stamp | None = Field(description="s since 1970; null: not yet")
    preflight: PreflightModel | None = Field(description="report, if the campaign runs preflights")
    fits: list[FitModel] = Field(description="one fit for each sensor instance, if the campaign fits")
    documents: list[DocumentModel] = Field(description="each report, if the campaign diagnoses")
