"""The context of one attempt to write a plan, which every step of the transaction uses."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any

from mavcal.calib.firmware.plan import ParameterKind, Value, WritePlan
from mavcal.calib.firmware.values import shown
from mavcal.service.errors import WriteFailed
from mavcal.service.jobs.core.crashpoints import CrashPoint, no_crash
from mavcal.service.jobs.core.handle import JobHandle, waiting
from mavcal.service.jobs.core.journal import same, who_sets
from mavcal.service.jobs.core.model import Accept
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.write.guard import WriteGuard
from mavcal.service.jobs.write.stream_check import StreamCheck
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.vehicle.job_vehicle import JobVehicle, ParameterReading


class Settling(StrEnum):
    """A phrase for what is waited for before values are read back."""

    SAVED = "waiting until the vehicle has saved"
    """Until all is saved, before a restart; the restart ends whatever could rewrite a value later."""
    KEPT = "waiting until the vehicle has saved and nothing rewrites the values"
    RESTARTED = "waiting until the vehicle has started and nothing rewrites the values"
    """Until possible rewrites after a restart; nothing is left to be saved."""


@dataclass
class WriteContext:
    """Vehicle, plan, guard and settings of one attempt."""

    handle: JobHandle
    vehicle: JobVehicle
    plan: WritePlan
    accept: Accept
    check: StreamCheck
    settings: JobSettings = field(default_factory=JobSettings)
    reach: CrashPoint = no_crash
    guard: WriteGuard = field(init=False)
    heard: dict[str, Value] = field(init=False, default_factory=dict)
    """Values heard since the last PARAM_SET of each name; no proof, since a late echo may be among them."""

    def __post_init__(self) -> None:
        self.guard = WriteGuard(self.vehicle, self.settings.watch_s)

    def hear(self, reading: ParameterReading) -> None:
        """Store the value of a PARAM_VALUE."""
        self.heard[reading.name] = reading.value

    async def set(self, name: str, value: Value, kind: ParameterKind, *, instead_of: Value) -> Value:
        """Write one parameter under the guard; returns what the vehicle confirmed.

        Raises
        ------
        WriteFailed
            As soon as the vehicle states a value that is neither ours nor the one `instead_of` which it is written:
            somebody else or the vehicle has set it, and is not overwritten by a repetition.
        WriteStopped, ParameterError
        """
        self.heard.pop(name, None)
        foreign: asyncio.Future[Value] = asyncio.get_running_loop().create_future()

        def watch(reading: ParameterReading) -> None:
            known = same(reading.value, value, kind) or same(reading.value, instead_of, kind)
            if reading.name == name and not known and not foreign.done():
                foreign.set_result(reading.value)

        forget = self.vehicle.on_parameter(watch)
        setting = asyncio.ensure_future(self.guard.run(partial(self.vehicle.set_parameter, name, value, kind)))
        try:
            either: set[asyncio.Future[Any]] = {setting, foreign}
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if foreign.done():
                setting.cancel()
                await self.confirm_identity()
                raise WriteFailed(f"{who_sets(name)} set {name} to {shown(foreign.result())} meanwhile")
            return setting.result().value
        finally:
            forget()
            if not setting.cancelling():  # a second time would cut short how it gives up
                setting.cancel()
            await asyncio.wait({setting})
            if not setting.cancelled():
                setting.exception()  # said already, or overtaken by a stronger reason

    async def confirm_identity(self) -> None:
        """Ask the vehicle for its identity, because a value is neither the new nor the old one.

        It may be another vehicle's at the same address, or this one's after a restart that its clock has not shown yet.

        Raises
        ------
        WriteStopped
            If it is.
        CommandTimeout
            If nobody says.
        """
        await self.guard.run(self.vehicle.identify)
        await self.require_same_boot()

    async def require_same_boot(self) -> None:
        """Wait for the vehicle's clock: if the vehicle restarts, the restart is the cause of a failure.

        Raises
        ------
        WriteStopped
            If it restarted, or may not be written to for another reason.
        """
        await self.guard.run(self._hear_clock)
        self.guard.check()

    async def _hear_clock(self) -> None:
        loop = asyncio.get_running_loop()
        deadline, before = loop.time() + self.settings.same_boot_s, self.vehicle.condition().boot_time
        while self.vehicle.condition().boot_time == before is not None and loop.time() < deadline:  # noqa: ASYNC110
            await asyncio.sleep(self.settings.watch_s)

    async def get(self, name: str) -> Value:
        """Read one parameter under the guard."""
        return (await self.guard.run(partial(self.vehicle.read_parameter, name))).value

    def old_values(self) -> dict[str, Value]:
        """The values of the plan's parameters before the write. Raises WriteFailed if they were not stored."""
        kept = self.handle.store.snapshot(self.handle.id, SnapshotPurpose.BEFORE_WRITE)
        if kept is None:
            raise WriteFailed("there is no snapshot of the old values: nothing is written")
        return {change.name: kept.body[change.name]["value"] for change in self.plan.changes}

    def composed_on(self) -> Mapping[str, Value]:
        """The parameters that the plan rests on, as they were when it was made."""
        kept = self.handle.store.snapshot(self.handle.id, SnapshotPurpose.COMPOSED_ON)
        return {} if kept is None else kept.body

    async def settle(self, until: Settling = Settling.KEPT) -> None:
        """Wait under the guard until the vehicle has settled, by its clock or by ours."""
        per_autopilot = self.settings.save_s if until == Settling.SAVED else self.settings.settle_s
        needed = per_autopilot.get(self.plan.fingerprint.autopilot, max(per_autopilot.values()))
        now = self.vehicle.condition().boot_time
        since = 0.0 if until == Settling.RESTARTED else now
        passed = now - since if now is not None and since is not None else 0.0
        async with waiting(self.handle, until.value, max(needed - passed, 0.0)):
            await self.guard.run(partial(self._settled, needed, since))

    async def _settled(self, needed: float, boot_time: float | None) -> None:
        settings = self.settings
        loop = asyncio.get_running_loop()
        begun = loop.time()
        while (waited := loop.time() - begun) < needed:
            now = self.vehicle.condition().boot_time
            passed = now - boot_time if now is not None and boot_time is not None else waited
            if passed >= needed and waited >= settings.settle_least_s:
                return
            await asyncio.sleep(settings.watch_s)
