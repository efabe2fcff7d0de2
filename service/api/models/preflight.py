"""Preflights: what is asked for, and what every check says."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from mavcal.calib.preflight.check import CheckId, Verdict
from mavcal.service.api.models.base import Json, Request, Stamp
from mavcal.service.fixing import Fixable
from mavcal.service.jobs.core.states import JobState


class PreflightRequest(Request):
    """Check a vehicle that stands still."""

    heading: float | None = Field(
        default=None, ge=0.0, le=360.0, description="true heading of its nose, deg, if it is known"
    )
    fix: Annotated[list[Literal["gyro", "level"]], Field(max_length=2)] = Field(
        default_factory=list,
        description="calibrations that need no hands, to be run and written before it is checked; needs the scope "
        "write-params, and takes up to a minute each",
    )


class RestoreRequest(Request):
    """Put the last verified calibration back."""

    only: list[str] = Field(
        default=[], description="these sensors alone, as gyro0 or accel1; empty: all, and what belongs to the board"
    )
    mark_calibrated: bool = Field(default=True, description="ArduPilot: mark the sensors as calibrated")

    def given(self) -> Json:
        """What was said, and nothing else."""
        return self.model_dump(exclude_unset=True)


class CheckModel(BaseModel):
    """One check; value, sd and limit are those of its worst number, null where it has none."""

    id: CheckId
    verdict: Verdict
    value: float | None = Field(description="in `unit`")
    sd: float | None = Field(description="standard deviation of `value`, in `unit`: noise and whatever else limits it")
    limit: float | None = Field(description="in `unit`")
    unit: str = Field(description="empty: a pure number, or none")
    reason: str
    remedy: str = Field(description="what helps; empty where nothing has to be done")
    evidence: list[str] = Field(description="every number and fact that the check rests on")
    suspects: list[str] = Field(
        default=[],
        description="what is off; several: all of them, or one of them and nothing tells which, as the reason says",
    )


class FixModel(BaseModel):
    """A calibration that was run before the checks."""

    kind: Fixable
    job_id: str
    state: JobState
    text: str = Field(description="what came of it")


class PreflightModel(BaseModel):
    """Whether a vehicle is fit to fly, as far as its sensors and their calibration go."""

    vehicle_id: str
    at: Stamp
    seconds: float = Field(description="how long it took, s")
    verdict: Verdict = Field(description="any failure fails the whole; then warnings count, then what is unknown")
    summary: str
    checks: list[CheckModel]
    notes: list[str] = Field(description="what stood in the way of looking")
    fixed: list[FixModel]
