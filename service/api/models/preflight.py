"""Preflights: requests, and the results of the checks."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from mavcal.calib.preflight.check import Check, Verdict
from mavcal.service.api.models.wire import Json, Request, Stamp, Wire
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
        """Only the options that were given."""
        return self.model_dump(exclude_unset=True)


CheckModel = Annotated[Check, Wire("CheckModel", lacking=("suspects",))]


class FixModel(BaseModel):
    """A calibration that was run before the checks."""

    # A Fix without the sensors that would need a restart.
    kind: Fixable
    job_id: str
    state: JobState
    text: str = Field(description="what came of it")


class PreflightModel(BaseModel):
    """Whether a vehicle is fit to fly, as far as its sensors and their calibration go."""

    # A Preflight with its report flattened, and what was calibrated before.
    vehicle_id: str
    at: Stamp
    seconds: float = Field(description="how long it took, s")
    verdict: Verdict = Field(description="any failure fails the whole; then warnings count, then what is unknown")
    summary: str
    checks: list[CheckModel]
    notes: list[str] = Field(description="what stood in the way of looking")
    fixed: list[FixModel]
