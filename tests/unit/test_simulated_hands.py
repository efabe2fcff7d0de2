"""Whose hands move a simulated vehicle, and when."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.service import simulated_hands as module
from mavcal.service.errors import HandBusy, LinkDown, NotSimulated
from mavcal.service.jobs.core.states import JobState
from mavcal.service.link.endpoint import Hand
from mavcal.service.simulated_hands import MOMENT_S, SimulatedHands
from mavcal.service.simvehicle import ControlError
from tests.unit.api import samples


class Operator:
    """Hands that note what they were asked; `gone`: their vehicle does not answer."""

    def __init__(self):
        self.done, self.gone = [], False

    def _do(self, what, how):
        if self.gone:
            raise ControlError("it has gone")
        self.done.append((what, how))

    def turn_to(self, attitude):
        self._do("turn", attitude)

    def follow(self, prompt):
        self._do("follow", prompt["text"])


@pytest.fixture
def operator(monkeypatch):
    """The hands at every control channel, and the addresses of these."""
    made = Operator()
    made.addresses = []
    monkeypatch.setattr(module, "ControlChannel", lambda address: made.addresses.append(address) or SimpleNamespace())
    monkeypatch.setattr(module, "Operator", lambda _channel: made)
    return made


def vehicle(hand=Hand.AUTO, control="tcp:s:1", name="v1"):
    return SimpleNamespace(id=name, link=SimpleNamespace(id=f"link of {name}", hand=hand, sim_control=control))


@pytest.mark.parametrize(("hand", "control"), [(None, "tcp:s:1"), (Hand.MOUSE, None)])
async def test_nobody_moves_a_real_vehicle(operator, hand, control):
    hands, real = SimulatedHands(list, list), vehicle(hand, control)
    with pytest.raises(NotSimulated):
        hands.choose(real, Hand.MOUSE)
    with pytest.raises(NotSimulated):
        await hands.turn(real, [1.0, 0.0, 0.0, 0.0])
    assert (real.link.hand, operator.done) == (hand, [])


async def test_who_moves_it_is_chosen_and_only_then_may_turn_it(operator):
    hands, there = SimulatedHands(list, list), vehicle()
    with pytest.raises(HandBusy):
        await hands.turn(there, [1.0, 0.0, 0.0, 0.0])
    hands.choose(there, Hand.MOUSE)
    await hands.turn(there, [0.0, 0.0, 0.0, -1.005])  # its digits were rounded on the way
    assert operator.done == [("turn", [0.0, 0.0, 0.0, -1.0])]


@pytest.mark.parametrize(
    "attitude", [[0.0] * 4, [2.0, 0.0, 0.0, 0.0], [float("nan"), 0.0, 0.0, 1.0], [0.98, 0.0, 0.0, 0.0]]
)
async def test_what_is_no_attitude_turns_nothing(operator, attitude):
    with pytest.raises(InvalidInputError, match="give a quaternion of length 1"):
        await SimulatedHands(list, list).turn(vehicle(Hand.MOUSE), attitude)
    assert operator.done == []


async def test_a_vehicle_that_has_gone_is_said(operator):
    operator.gone = True
    with pytest.raises(LinkDown, match="does not answer: it has gone"):
        await SimulatedHands(list, list).turn(vehicle(Hand.MOUSE), [1.0, 0.0, 0.0, 0.0])


async def test_an_operator_is_kept_as_long_as_its_address(operator):
    hands, there = SimulatedHands(list, list), vehicle(Hand.MOUSE)
    for control in ("tcp:s:1", "tcp:s:1", "tcp:s:2"):
        there.link.sim_control = control
        await hands.turn(there, [1.0, 0.0, 0.0, 0.0])
    assert operator.addresses == ["tcp:s:1", "tcp:s:2"]


class Prompted:
    """Hands that look at the jobs of one vehicle whenever it is told; time is what it is told as well."""

    def __init__(self, monkeypatch, *jobs, hand=Hand.AUTO):
        self.jobs, self.now = list(jobs), 1000.0
        self.hands = SimulatedHands(lambda: [vehicle(hand)], lambda: self.jobs)
        monkeypatch.setattr(
            module, "asyncio", SimpleNamespace(get_running_loop=lambda: self, to_thread=asyncio.to_thread)
        )

    def time(self):
        return self.now

    async def look(self, after=0.0):
        self.now += after
        await self.hands._look()


ASKING = samples.job(state=JobState.WAITING_FOR_OPERATOR)


async def test_a_prompt_is_read_before_it_is_followed_and_followed_as_long_as_it_stands(operator, monkeypatch):
    prompted = Prompted(monkeypatch, ASKING)
    await prompted.look()
    await prompted.look(0.9 * MOMENT_S)
    assert operator.done == []
    await prompted.look(0.2 * MOMENT_S)
    await prompted.look()
    assert operator.done == [("follow", samples.PROMPT.text)] * 2


@pytest.mark.parametrize(
    ("job", "hand"),
    [
        (samples.job(state=JobState.IN_DOUBT), Hand.AUTO),  # it captures nothing
        (samples.job(state=JobState.WAITING_FOR_OPERATOR, prompt=None), Hand.AUTO),
        (samples.job(state=JobState.FAILED), Hand.AUTO),
        (samples.job(state=JobState.WAITING_FOR_OPERATOR, vehicle_id="v2"), Hand.AUTO),
        (ASKING, Hand.MOUSE),
    ],
)
async def test_nothing_is_moved_that_nobody_asks_for(operator, monkeypatch, job, hand):
    prompted = Prompted(monkeypatch, job, hand=hand)
    for _ in range(3):
        await prompted.look(10.0 * MOMENT_S)
    assert operator.done == []


async def test_the_newest_job_counts_and_a_vehicle_that_has_gone_is_no_error(operator, monkeypatch):
    newer = samples.job(id="j2", state=JobState.RUNNING, prompt=None)
    prompted = Prompted(monkeypatch, ASKING, newer)
    for _ in range(2):
        await prompted.look(10.0 * MOMENT_S)
    assert operator.done == []
    prompted.jobs.remove(newer)
    operator.gone = True
    for _ in range(2):
        await prompted.look(10.0 * MOMENT_S)
