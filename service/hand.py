"""The hand that moves simulated vehicles: it does what the prompts of their jobs ask for, as a person would."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import structlog

from mavcal.service.jobs.codec import to_json
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.states import CAPTURING, ENDED
from mavcal.service.link import Link
from mavcal.service.simvehicle import ControlChannel, ControlError, Operator
from mavcal.service.vehicle import Vehicle

log = structlog.get_logger(__name__)

LOOK_S = 0.5
"""How often prompts are looked at."""
MOMENT_S = 1.5
"""How long a person reads a new prompt before the hands move."""
OFF = "off"
"""`sim:ardupilot?hand=off`: the vehicle stays where it is put."""


class AutoHand:
    """Moves every simulated vehicle of this service, unless its endpoint says ``hand=off``."""

    def __init__(self, vehicles: Callable[[], Iterable[Vehicle]], jobs: Callable[[], Iterable[Job]]) -> None:
        self._vehicles = vehicles
        self._jobs = jobs
        self._operators: dict[str, tuple[str, ControlChannel, Operator]] = {}
        self._read: dict[str, tuple[str, float]] = {}

    async def run(self) -> None:
        """Follow prompts until cancelled."""
        try:
            while True:
                await asyncio.sleep(LOOK_S)
                await self._look()
        finally:
            for _, channel, _ in self._operators.values():
                channel.close()

    async def _look(self) -> None:
        moved = {vehicle.id: vehicle.link for vehicle in self._vehicles() if _obeys(vehicle.link)}
        if not moved:
            return
        newest: dict[str, Job] = {}
        for job in self._jobs():
            if job.vehicle_id in moved and job.state not in ENDED:
                newest[job.vehicle_id or ""] = job
        for vehicle_id, job in newest.items():
            with suppress(ControlError):  # the vehicle has gone; its link tells
                await self._serve(moved[vehicle_id], job)

    async def _serve(self, link: Link, job: Job) -> None:
        prompt: dict[str, Any] | None = None if job.prompt is None else to_json(job.prompt)
        if prompt is None or job.state not in CAPTURING:
            return
        text, since = self._read.get(job.id, ("", 0.0))
        now = asyncio.get_running_loop().time()
        wanted = repr((prompt["step"], prompt["pose"], prompt["direction"], prompt["axis"], prompt["remaining"]))
        if wanted != text:
            self._read[job.id] = (wanted, now)
            return
        if now - since < MOMENT_S:
            return
        await asyncio.to_thread(self._operator(link).follow, prompt)

    def _operator(self, link: Link) -> Operator:
        address = link.sim_control or ""
        known = self._operators.get(link.id)
        if known is not None and known[0] == address:
            return known[2]
        channel = ControlChannel(address)
        operator = Operator(channel)
        self._operators[link.id] = (address, channel, operator)
        return operator


def _obeys(link: Link) -> bool:
    return link.sim_control is not None and link.endpoint.option("hand") != OFF
