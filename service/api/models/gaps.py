"""Diagnoses of the sim-to-real gap."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.service.api.models.wire import Json, Request, Stamp
from mavcal.service.jobs.core.states import JobState


class GapRequest(Request):
    """Diagnose the sim-to-real gap of uploaded recordings."""

    real: str = Field(description="id of the recording whose gap is asked for")
    sim: str | None = Field(default=None, description="id of a simulator's recording, of the same flight or such a one")
    nominal: list[str] = Field(
        default_factory=list, max_length=8, description="ids of recordings without an effect, for noise and field"
    )
    limit_s: float | None = Field(
        default=None,
        gt=0.0,
        allow_inf_nan=False,
        description="seconds of processor time after which the best answer so far is given; null: 60",
    )


class GapSummary(BaseModel):
    """A diagnosis in a list."""

    id: str
    href: str = Field(description="its address, relative to the root of the service")
    state: JobState = Field(description="that of the job, whose id is the same")
    error: str | None = Field(description="why it failed")
    created_at: Stamp
    real: str
    sim: str | None
    nominal: list[str]


class GapModel(GapSummary):
    """A diagnosis with its report."""

    report: Json | None = Field(description="as `mavcal gap --json`; null until it has succeeded")
    page: str | None = Field(description="address of the report as a page, relative to the root of the service")
