"""What an interrupted run has left on a vehicle."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.service.api.models.base import Stamp
from mavcal.service.api.models.jobs import JobSummary, StandingModel


class UnfinishedModel(BaseModel):
    """A job that claims its vehicle, and what is known of the parameters that it has sent."""

    job: JobSummary
    at: Stamp = Field(description="when this state was read; earlier events belong to the run that is over")
    writing: bool = Field(description="parameters of the vehicle may be this job's")
    ended: bool = Field(description="nothing of it is in doubt any more")
    sent: list[str] = Field(description="parameters for which a PARAM_SET may have left")
    standing: list[StandingModel] = Field(description="what is known of each of them")
    beginning: str = Field(description="what is going to happen to it")
    ending: list[str] = Field(description="how it ended, or what is in doubt, a sentence each")
