"""The stream of samples of a vehicle."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing

import numpy as np
from fastapi import APIRouter, Depends
from fastapi.sse import EventSourceResponse, ServerSentEvent

from mavcal.calib.recording import Channel
from mavcal.service.api.models import LiveModel, SamplesModel
from mavcal.service.api.security import Scope, require
from mavcal.service.api.vehicles import VehicleDep
from mavcal.service.live import LiveBatch, live_batches

router = APIRouter(tags=["vehicles"])


@router.get(
    "/vehicles/{vehicle_id}/samples",
    operation_id="follow_samples",
    response_class=EventSourceResponse,
    dependencies=[Depends(require(Scope.READ))],
)
async def samples(found: VehicleDep) -> AsyncIterator[ServerSentEvent]:
    """What the sensors read, ten times a second, as the vehicle streams it; asks the vehicle for nothing."""
    async with aclosing(live_batches(found)) as batches:  # type: ignore[type-var]
        async for batch in batches:
            yield ServerSentEvent(data=_model(batch), event="samples")


def _model(batch: LiveBatch) -> LiveModel:
    return LiveModel(
        channels=_samples(batch.channels),
        bare=_samples(batch.bare),
        attitude=batch.attitude,
        model_field_ut=batch.field,
    )


def _samples(channels: Sequence[Channel]) -> list[SamplesModel]:
    return [
        SamplesModel(
            sensor=channel.sensor,
            instance=channel.instance,
            unit=channel.unit,
            source=channel.source,
            t=np.round(channel.t, 4).tolist(),
            values=[[_digits(value) for value in axis] for axis in channel.values.T.tolist()],
        )
        for channel in channels
    ]


def _digits(value: float) -> float | None:
    """Six significant digits: no sensor has more, and a phone's link is slow."""
    return float(f"{value:.6g}") if np.isfinite(value) else None
