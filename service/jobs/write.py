"""Writing a plan to a vehicle: fresh snapshot, one parameter after the other in the plan's order, read-back.

Everything that is sent is announced in the journal before and confirmed after. A crash at any instant therefore leaves
enough to finish or to take back (:mod:`service.jobs.transaction`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any, Protocol

from mavcal.calib.firmware.in_force.fingerprint import fingerprint, matters
from mavcal.calib.firmware.plan import Change, ParameterKind, Value, Verification, WritePlan, snapshot_sha256
from mavcal.calib.firmware.values import shown
from mavcal.service.errors import ParameterMissing, PlanBlocked, PlanChanged, WriteFailed
from mavcal.service.jobs.account import who_sets
from mavcal.service.jobs.crashpoints import At, CrashPoint, nowhere
from mavcal.service.jobs.guard import WriteGuard
from mavcal.service.jobs.handle import JobHandle, counting, waiting
from mavcal.service.jobs.journal import JournalStep, same
from mavcal.service.jobs.model import Accept
from mavcal.service.jobs.port import JobVehicle, ParameterReading
from mavcal.service.jobs.settings import JobSettings
from mavcal.service.store.rows import SnapshotPurpose

READS_IN_FLIGHT = 10
"""ArduPilot queues 20 reads and answers 5 at a time; what exceeds that is dropped (FLIGHT_CONTROLLERS 3.1)."""


class PhysicalCheck(Protocol):
    """Looks at the stream before and after a write (DESIGN 6, rule 4)."""

    async def before(self, guard: WriteGuard) -> None:
        """Keep a window of the stream under the old parameters."""
        ...

    async def after(self, guard: WriteGuard, values: Mapping[str, Value]) -> Verification:
        """Judge the stream under the new parameters, `values`; may ask the operator for movements."""
        ...


class Settling(StrEnum):
    """What is waited for before values are read back, in words."""

    SAVED = "waiting until the vehicle has saved"
    """Before a restart, which also ends whatever could rewrite a value later."""
    KEPT = "waiting until the vehicle has saved and nothing rewrites the values"
    RESTARTED = "waiting until the vehicle has started and nothing rewrites the values"
    """Nothing waits to be saved; what rewrites a value does so as long after the start as after a write."""


@dataclass
class Writing:
    """What every part of a write transaction works with."""

    handle: JobHandle
    vehicle: JobVehicle
    plan: WritePlan
    accept: Accept
    check: PhysicalCheck
    settings: JobSettings = field(default_factory=JobSettings)
    reach: CrashPoint = nowhere
    guard: WriteGuard = field(init=False)
    heard: dict[str, Value] = field(init=False, default_factory=dict)
    """Values heard since the last PARAM_SET of each name; not proof, a late echo may be among them."""

    def __post_init__(self) -> None:
        self.guard = WriteGuard(self.vehicle, self.settings.watch_s)

    def hear(self, reading: ParameterReading) -> None:
        """Take note of a PARAM_VALUE."""
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
                await self.ask_who()
                raise WriteFailed(f"{who_sets(name)} set {name} to {shown(foreign.result())} meanwhile")
            return setting.result().value
        finally:
            forget()
            if not setting.cancelling():  # a second time would cut short how it gives up
                setting.cancel()
            await asyncio.wait({setting})
            if not setting.cancelled():
                setting.exception()  # said already, or overtaken by a stronger reason

    async def ask_who(self) -> None:
        """Ask who answers, where a value is neither ours nor the old one.

        It may be another vehicle's at the same address, or this one's after a restart that its clock has not shown yet.

        Raises
        ------
        WriteStopped
            If it is.
        CommandTimeout
            If nobody says.
        """
        await self.guard.run(self.vehicle.identify)
        await self.same_boot()

    async def same_boot(self) -> None:
        """Wait until the vehicle's clock was heard again: what fails while it restarts is no cause, the restart is.

        Raises
        ------
        WriteStopped
            If it restarted, or may not be written to for another reason.
        """
        await self.guard.run(self._clock_heard)
        self.guard.check()

    async def _clock_heard(self) -> None:
        loop = asyncio.get_running_loop()
        deadline, before = loop.time() + self.settings.same_boot_s, self.vehicle.condition().boot_time
        while self.vehicle.condition().boot_time == before is not None and loop.time() < deadline:  # noqa: ASYNC110
            await asyncio.sleep(self.settings.watch_s)

    async def get(self, name: str) -> Value:
        """Read one parameter under the guard."""
        return (await self.guard.run(partial(self.vehicle.read_parameter, name))).value

    def old_values(self) -> dict[str, Value]:
        """What every parameter of the plan held before the write; raises WriteFailed if that was not kept."""
        kept = self.handle.store.snapshot(self.handle.id, SnapshotPurpose.BEFORE_WRITE)
        if kept is None:
            raise WriteFailed("there is no snapshot of the old values: nothing is written")
        return {change.name: kept.body[change.name]["value"] for change in self.plan.changes}

    def composed_on(self) -> Mapping[str, Value]:
        """The parameters that the plan rests on, as they were when it was made."""
        kept = self.handle.store.snapshot(self.handle.id, SnapshotPurpose.COMPOSED_ON)
        return {} if kept is None else kept.body

    async def settle(self, until: Settling = Settling.KEPT) -> None:
        """Wait under the guard until the vehicle has come so far, by its clock or by ours."""
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


async def read_values(
    vehicle: JobVehicle,
    names: Iterable[str],
    *,
    absent: bool = False,
    told: Callable[[int], None] | None = None,
) -> dict[str, ParameterReading]:
    """Fresh values of `names`, a few requests at a time.

    Parameters
    ----------
    vehicle, names
        Whom to ask for what.
    absent
        Whether a name that the vehicle does not have is left out; otherwise it is an error.
    told
        Called with how many were answered so far.

    Raises
    ------
    ParameterMissing, ParameterTimeout
    """
    gate = asyncio.Semaphore(READS_IN_FLIGHT)
    found: dict[str, ParameterReading | None] = {}

    async def one(name: str) -> None:
        async with gate:
            try:
                found[name] = await vehicle.read_parameter(name)
            except ParameterMissing:
                if not absent:
                    raise
                found[name] = None
        if told is not None:
            told(len(found))

    wanted = tuple(dict.fromkeys(names))
    try:
        async with asyncio.TaskGroup() as group:
            for name in wanted:
                group.create_task(one(name))
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None
    return {name: reading for name in wanted if (reading := found[name]) is not None}


async def check_plan(w: Writing) -> dict[str, ParameterReading]:
    """Make sure that the plan still fits the vehicle; returns fresh readings of everything that it rests on.

    Raises
    ------
    PlanBlocked, PlanChanged
        With what is in the way, or what differs.
    """
    if w.plan.blockers:
        raise PlanBlocked("the plan may not be written: " + "; ".join(w.plan.blockers))
    composed_on = w.composed_on()
    identity = await w.vehicle.identify()
    try:
        names = list(dict.fromkeys([*composed_on, *(change.name for change in w.plan.changes)]))
        told = counting(w.handle, "reading what the plan rests on")
        fresh = await read_values(w.vehicle, names, told=lambda done: told(done, len(names)))
    except ParameterMissing as error:
        raise PlanChanged(f"the vehicle no longer has {error.name}: plan again") from error
    now = {name: fresh[name].value for name in composed_on if matters(name, w.plan.sensors)}
    differing = [f"{n} was {shown(composed_on[n])} and is {shown(v)}" for n, v in now.items() if v != composed_on[n]]
    if differing:
        raise PlanChanged(f"parameters changed since the plan was made: {', '.join(differing)}. Plan again")
    if snapshot_sha256(now) != w.plan.snapshot_sha256 or fingerprint(identity, now) != w.plan.fingerprint:
        raise PlanChanged
    _check_kinds(w.plan, fresh)
    return fresh


async def prepare(w: Writing) -> None:
    """Check the plan against the vehicle and keep the old values. Nothing is sent yet.

    Raises
    ------
    PlanBlocked, PlanChanged, WriteStopped
    """
    fresh = await w.guard.run(partial(check_plan, w))
    await _keep_snapshot(w, {change.name: fresh[change.name] for change in w.plan.changes})


def _check_kinds(plan: WritePlan, fresh: Mapping[str, ParameterReading]) -> None:
    wrong = [f"{c.name} is {fresh[c.name].kind}, not {c.kind}" for c in plan.changes if fresh[c.name].kind != c.kind]
    if wrong:
        raise PlanChanged(f"the vehicle's types are not those of the plan: {', '.join(wrong)}. Plan again")


async def _keep_snapshot(w: Writing, old: Mapping[str, ParameterReading]) -> None:
    body = {name: {"value": reading.value, "kind": reading.kind.value} for name, reading in old.items()}
    digest = snapshot_sha256({name: reading.value for name, reading in old.items()})
    store = w.handle.store
    at = w.handle.now()
    await store.do(lambda: store.add_snapshot(w.handle.id, at, SnapshotPurpose.BEFORE_WRITE, digest, body))
    await w.handle.record(JournalStep.SNAPSHOT, sha256=digest)
    w.reach(At.SNAPSHOT_KEPT)


async def send_all(w: Writing) -> None:
    """Write every parameter of the plan in its order. Raises WriteStopped, ParameterError."""
    before = w.old_values()
    told = counting(w.handle, "writing")
    for number, change in enumerate(w.plan.changes):
        w.guard.check()
        told(number, len(w.plan.changes))
        old = before[change.name]
        await w.handle.record(
            JournalStep.SEND, name=change.name, old=old, new=change.new, kind=change.kind.value, session=change.session
        )
        w.reach(At.BEFORE_SEND)
        value = await w.set(change.name, change.new, change.kind, instead_of=old)
        w.reach(At.AFTER_ECHO)
        await w.handle.record(JournalStep.ECHO, name=change.name, value=value)
        w.reach(At.ECHO_KEPT)
    told(len(w.plan.changes), len(w.plan.changes))


async def read_back(w: Writing, until: Settling = Settling.KEPT) -> dict[str, Value]:
    """Wait until the vehicle has come so far, then read everything again.

    Raises
    ------
    WriteFailed
        Naming every parameter that does not hold its new value.
    """
    await w.settle(until)
    values = await current_values(w)
    check_in_place(w.plan.changes, values)
    await w.handle.record(JournalStep.READ_BACK, at=w.handle.now(), boot_time=w.vehicle.condition().boot_time)
    w.reach(At.READ_BACK)
    return values


async def current_values(w: Writing) -> dict[str, Value]:
    """Fresh values of the plan's parameters, under the guard."""
    names = [change.name for change in w.plan.changes]
    told = counting(w.handle, "reading back")
    readings = await w.guard.run(partial(read_values, w.vehicle, names, told=lambda done: told(done, len(names))))
    return {name: reading.value for name, reading in readings.items()}


def check_in_place(changes: Iterable[Change], values: Mapping[str, Value]) -> None:
    """Raise WriteFailed naming every change whose new value is not among `values`."""
    wrong = [
        f"{c.name} holds {shown(values[c.name])} instead of {shown(c.new)}"
        for c in changes
        if not same(values[c.name], c.new, c.kind)
    ]
    if wrong:
        raise WriteFailed(f"the read-back differs: {', '.join(wrong)}")
