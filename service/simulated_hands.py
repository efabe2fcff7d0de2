"""Moves simulated vehicles: by the prompts of jobs, or as a person turns one in the panel."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import structlog

from mavcal.calib.errors import InvalidInputError
from mavcal.service.errors import HandBusy, LinkDown, NotSimulated
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import CAPTURING, ENDED, JobState
from mavcal.service.link.endpoint import Hand
from mavcal.service.link.link import Link
from mavcal.service.simvehicle import ControlChannel, ControlError, Operator
from mavcal.service.vehicle.vehicle import Vehicle

log = structlog.get_logger(__name__)

LOOK_S = 0.5
"""Period of the look at prompts, s."""
MOMENT_S = 1.5
"""Time that a person reads a new prompt before the hands move, s."""
UNIT_WITHIN = 0.01
"""Largest departure of an attitude's length from 1: its digits were rounded on the way."""


class SimulatedHands:
    """Moves the simulated vehicles of this service, each as its link says."""

    def __init__(self, vehicles: Callable[[], Iterable[Vehicle]], jobs: Callable[[], Iterable[Job]]) -> None:
        self._vehicles = vehicles
        self._jobs = jobs
        self._operators: dict[str, tuple[str, ControlChannel, Operator]] = {}
        self._read: dict[str, tuple[str, float]] = {}
        self._making = threading.Lock()

    async def run(self) -> None:
        """Follow prompts until cancelled."""
        try:
            while True:
                await asyncio.sleep(LOOK_S)
                await self._look()
        finally:
            for _, channel, _ in self._operators.values():
                channel.close()

    def choose(self, vehicle: Vehicle, hand: Hand) -> None:
        """Say who moves a vehicle from now on. Raises NotSimulated if it is a real one."""
        _require_simulated(vehicle)
        vehicle.link.hand = hand

    async def turn(self, vehicle: Vehicle, attitude: Sequence[float]) -> None:
        """Turn a vehicle by hand to an attitude, w x y z, body to north-east-down; returns before it is reached.

        Raises
        ------
        NotSimulated
            If it is a real one.
        HandBusy
            If nobody has chosen to turn it with the mouse.
        InvalidInputError
            If the four numbers are no attitude.
        LinkDown
            If it has gone.
        """
        _require_simulated(vehicle)
        if vehicle.link.hand is not Hand.MOUSE:
            raise HandBusy
        length = math.hypot(*attitude)
        if not abs(length - 1.0) < UNIT_WITHIN:
            raise InvalidInputError(f"the attitude has the length {length:g}: give a quaternion of length 1")
        try:
            await asyncio.to_thread(self._turned, vehicle.link, [part / length for part in attitude])
        except ControlError as error:
            raise LinkDown(f"The simulated vehicle does not answer: {error}") from error

    def _turned(self, link: Link, attitude: Sequence[float]) -> None:
        self._operator(link).turn_to(attitude)

    async def _look(self) -> None:
        moved = {vehicle.id: vehicle.link for vehicle in self._vehicles() if vehicle.link.hand is Hand.AUTO}
        if not moved:
            return
        newest: dict[str, Job] = {}
        for job in self._jobs():
            if job.vehicle_id in moved and job.state not in ENDED:
                newest[job.vehicle_id or ""] = job
        for vehicle_id, link in moved.items():
            with suppress(ControlError):  # the vehicle has gone; its link tells
                present = newest.get(vehicle_id)
                if present is not None:
                    await self._serve(link, present)
                if self._is_left(link, present):
                    await asyncio.to_thread(self._operator(link).rest)

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
        await asyncio.to_thread(self._followed, link, prompt)

    def _is_left(self, link: Link, job: Job | None) -> bool:
        """Whether the vehicle is to be brought to rest: its job has ended, or is in review while it still turns."""
        if link.id not in self._operators:
            return False
        _, _, operator = self._operators[link.id]
        if job is None:
            return not operator.resting
        return job.state == JobState.REVIEW and operator.turning

    def _followed(self, link: Link, prompt: dict[str, Any]) -> None:
        self._operator(link).follow(prompt)

    def _operator(self, link: Link) -> Operator:
        address = link.sim_control or ""
        with self._making:
            known = self._operators.get(link.id)
            if known is not None and known[0] == address:
                return known[2]
            channel = ControlChannel(address)
            operator = Operator(channel)
            self._operators[link.id] = (address, channel, operator)
            return operator


def _require_simulated(vehicle: Vehicle) -> None:
    if vehicle.link.hand is None or vehicle.link.sim_control is None:
        raise NotSimulated
