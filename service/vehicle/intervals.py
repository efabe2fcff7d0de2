"""Message intervals of a vehicle: read and set, one or many at once.

An acknowledgement names only the command, so that of many at once none says which message it is for. MESSAGE_INTERVAL
names its message: it confirms what was set, and many are waited for together. On a link that loses 15 % each way, eight
messages that were asked for one after the other took most of a minute.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CommandRefused, CommandTimeout
from mavcal.service.vehicle import commands
from mavcal.service.vehicle.identity import Autopilot

if TYPE_CHECKING:
    from mavcal.service.vehicle.exchange import Expectation
    from mavcal.service.vehicle.vehicle import Vehicle

DEFAULT_INTERVAL = 0
"""Interval that means the firmware's default."""
ROUNDS = 6
"""Number of rounds. At 15 % loss each way, one of eight messages then stays unanswered in one of 30 cases."""
ANSWER_S, ANSWER_LEAST_S = 1.0, 0.5
ROUNDED = 0.1
"""Firmwares round intervals: an interval in force may differ by this share."""
_DIFFERENT = 2
"""Number of answers with another interval after which a message is requested alone: it is refused, or slowed down."""
_INTERVAL, _ACK = dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_COMMAND_ACK
_REFUSED = -1
_Question = tuple[int, tuple[float, ...]]


async def set_interval(vehicle: Vehicle, message_id: int, interval_us: float) -> None:
    """SET_MESSAGE_INTERVAL: -1 off, 0 default. Parameters 3 to 7 must be 0 (ArduPilot refuses others)."""
    await vehicle.command(commands.SET_MESSAGE_INTERVAL, (message_id, interval_us))


async def get_interval(vehicle: Vehicle, message_id: int) -> int | None:
    """The interval in us as stated by the vehicle (-1 off, 0 unknown to it), or None if it does not answer."""

    def match(frame: Frame) -> int | None:
        message = decode(frame)
        return int(message.interval_us) if message.message_id == message_id else None

    with vehicle.waits.expect({_INTERVAL}, match) as answer:
        for command_id, params in _questions(vehicle, message_id):
            try:
                await vehicle.command(command_id, params, retries=1)
            except (CommandRefused, CommandTimeout):
                continue
            interval = await answer.within(1.0)
            if interval is not None:
                _note(vehicle, vehicle.way, {message_id: interval})
                return interval
    return None


async def get_intervals(vehicle: Vehicle, message_ids: Iterable[int]) -> dict[int, int]:
    """The intervals in us as stated by the vehicle; 0 is the firmware's default, also where it does not answer."""
    wanted, way = tuple(message_ids), vehicle.way
    together = _Together(vehicle, wanted)
    await together.ask()
    if vehicle.way == way:  # else nobody knows which link these are of
        _note(vehicle, way, together.answered)
    return {message_id: together.answered.get(message_id, DEFAULT_INTERVAL) for message_id in wanted}


async def set_intervals(vehicle: Vehicle, intervals_us: Mapping[int, float]) -> dict[int, int | None]:
    """Set intervals in the order of the mapping; MAV_RESULT of each, None where it was not acknowledged.

    All are asked for at once and confirmed by what the vehicle tells. What it tells otherwise, or not at all, is asked
    for by itself. Raises VehicleSilent, LinkDown.
    """
    together = _Together(vehicle, [key for key, us in intervals_us.items() if us != DEFAULT_INTERVAL], intervals_us)
    if len(together.left) > 1:
        await together.ask()
    return {
        message_id: commands.ACCEPTED if message_id in together.answered else await _set(vehicle, message_id, interval)
        for message_id, interval in intervals_us.items()
    }


class _Together:
    """Intervals of many messages, requested in rounds until each is answered, and set before each request if given."""

    def __init__(
        self, vehicle: Vehicle, wanted: Iterable[int], intervals_us: Mapping[int, float] | None = None
    ) -> None:
        self.left = list(wanted)
        self.answered: dict[int, int] = {}
        """The intervals that the vehicle answered. Of those that were set, only the ones that it took as asked."""
        self._vehicle = vehicle
        self._intervals_us = intervals_us
        self._different: Counter[int] = Counter()
        self._refused = 0
        self._question = 0

    async def ask(self) -> None:
        """Ask; what is still :attr:`left` then was not answered, or otherwise than asked for."""
        vehicle = self._vehicle
        busy = (commands.SET_MESSAGE_INTERVAL, commands.GET_MESSAGE_INTERVAL, commands.REQUEST_MESSAGE)
        async with AsyncExitStack() as locked:
            for command_id in busy:
                await locked.enter_async_context(vehicle.command_lock(command_id))
            # one expectation for all rounds: an answer may come after its round
            with vehicle.waits.expect({_INTERVAL, _ACK}, self._match) as answer:
                for number in range(ROUNDS):
                    if not self.left:
                        return
                    self._send(number)
                    await self._hear(answer, first=number == 0)

    def _send(self, number: int) -> None:
        self._refused = 0
        for message_id in self.left:
            if self._intervals_us is not None:
                self._vehicle.send_command(commands.SET_MESSAGE_INTERVAL, message_id, self._intervals_us[message_id])
            questions = _questions(self._vehicle, message_id)
            self._question, params = questions[number % len(questions)]
            self._vehicle.send_command(self._question, *params)

    def _match(self, frame: Frame) -> tuple[int, int] | None:
        """An interval of a message, or (-1, result) for a question that was refused."""
        message = decode(frame)
        if frame.message_id == _INTERVAL:
            return int(message.message_id), int(message.interval_us)
        refused = message.result not in (commands.ACCEPTED, commands.IN_PROGRESS)
        return (_REFUSED, int(message.result)) if refused and message.command == self._question else None

    async def _hear(self, answer: Expectation[tuple[int, int]], *, first: bool) -> None:
        vehicle, asked = self._vehicle, self._vehicle.clock()
        until = asked + vehicle.pace.patience(ANSWER_S, ANSWER_LEAST_S)
        awaited = set(self.left)
        while len(awaited) > self._refused:
            got = await answer.within(until - vehicle.clock())
            if got is None:
                return
            message_id, value = got
            if message_id == _REFUSED:
                self._refused += 1
            elif message_id in awaited:
                if first:  # asked once: no doubt which question this answers
                    vehicle.pace.answered(vehicle.clock() - asked)
                    first = False
                awaited.remove(message_id)
                self._take(message_id, value)

    def _take(self, message_id: int, interval_us: int) -> None:
        wanted = None if self._intervals_us is None else self._intervals_us[message_id]
        if wanted is None or _as_asked(wanted, interval_us):
            self.answered[message_id] = interval_us
            self.left.remove(message_id)
            return
        self._different[message_id] += 1
        if self._different[message_id] >= _DIFFERENT:
            self.left.remove(message_id)


def _note(vehicle: Vehicle, way: str, answered_us: Mapping[int, int]) -> None:
    """Note the intervals of a link for which nothing has been requested yet."""
    for message_id, interval in answered_us.items():
        if message_id not in vehicle.rates.requested_us:
            vehicle.rates.note_before(way, message_id, interval)


async def _set(vehicle: Vehicle, message_id: int, interval_us: float) -> int | None:
    try:
        await set_interval(vehicle, message_id, interval_us)
    except CommandRefused as exc:
        return exc.result
    except CommandTimeout:
        return None
    return commands.ACCEPTED


def _as_asked(asked_us: float, answered_us: int) -> bool:
    return answered_us == -1 if asked_us < 0 else answered_us > 0 and abs(answered_us - asked_us) <= ROUNDED * asked_us


def _questions(vehicle: Vehicle, message_id: int) -> list[_Question]:
    """The requests for an interval; first the one that this firmware answers."""
    ask: list[_Question] = [
        (commands.GET_MESSAGE_INTERVAL, (message_id,)),
        (commands.REQUEST_MESSAGE, (_INTERVAL, message_id)),
    ]
    if vehicle.identity.autopilot is Autopilot.PX4:
        ask.reverse()
    return ask
