"""The parameter protocol of one vehicle: what its values are, and how they are read and written.

Every PARAM_VALUE that is heard keeps :class:`Parameters` current, whoever asked for it: a change by the firmware or
by another ground station shows here. Confirmations match the value, not just the name: a firmware may first echo
the neighbours of a vector, or repeat older values (FLIGHT_CONTROLLERS 3.1, 9, 10).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import RawMessage, decode, param_bytes, param_set
from mavcal.calib.wire.frames import Frame
from mavcal.calib.wire.parameters import ParameterEncoding, ParamType, heard_value
from mavcal.service.errors import (
    LinkDown,
    ParameterError,
    ParameterMissing,
    ParameterRejected,
    ParameterTimeout,
    VehicleError,
    VehicleSilent,
)
from mavcal.service.vehicle.exchange import Addressee, Expectation, Pace
from mavcal.service.vehicle.identity import VehicleIdentity
from mavcal.service.vehicle.parameter_bits import Parameter, bits_from_value, same_value

ANSWER_S = 1.0
READ_LEAST_S = 0.5
"""Shortest time before a read is repeated, s; on a bad link the cause is loss, and a repetition is cheap."""
TRIES = 3
_MOST_TRIES = 16
_GRACE_S = 0.3
_WAYS = 3
"""Number of links over which a write is tried, one after the other, as each falls silent."""
_VALUE, _ERROR = dialect.MAVLINK_MSG_ID_PARAM_VALUE, dialect.MAVLINK_MSG_ID_PARAM_ERROR
_DOES_NOT_EXIST = dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
_ERRORS = {2: "the value is out of range", 3: "permission denied", 5: "it is read only", 6: "type unsupported"}

ParameterListener = Callable[[Parameter, Parameter | None], None]
"""Called with a parameter just heard and what was known before (None: nothing)."""


@dataclass(frozen=True)
class Echo:
    """A confirmed write.

    Parameters
    ----------
    parameter
        As the vehicle holds it now.
    sent
        How many PARAM_SET messages it took.
    """

    parameter: Parameter
    sent: int


class Holder(Addressee, Protocol):
    """The vehicle that holds the parameters."""

    identity: VehicleIdentity
    """Identity of the vehicle, which decides how it encodes values."""

    pace: Pace
    """Pace of its answers."""

    @property
    def way(self) -> str:
        """Name of the link in use: it changes when that falls silent and there is another one."""

    async def caught_up(self) -> None:
        """Return once everything received from it by now is known. Raises LinkDown."""

    def require_writable(self, *, name: str = "", sent: int = 0) -> None:
        """Raise VehicleSilent, VehicleArmed, VehicleConflict or VehicleBusy if it may not be written to."""


class _Other:
    """The answer to the parameter that was requested after the one awaited."""


class Parameters(Mapping[str, Parameter]):
    """The parameters of one vehicle as last heard; a mapping by name, with the protocol as methods."""

    def __init__(self, vehicle: Holder) -> None:
        self._vehicle = vehicle
        self._known: dict[str, Parameter] = {}
        self._listeners: dict[object, ParameterListener] = {}
        self._jitter = 0.0
        self._asked: Counter[str] = Counter()
        """Number of readers that ask for each parameter now."""
        self.count: int | None = None
        """Length of the vehicle's list, as last said."""
        self.hash: bytes | None = None
        """PX4's hash as last heard."""

    def __getitem__(self, name: str) -> Parameter:
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._known))

    def __len__(self) -> int:
        return len(self._known)

    @property
    def encoding(self) -> ParameterEncoding:
        """Encoding in which this vehicle sends values."""
        return self._vehicle.identity.encoding

    def listen(self, listener: ParameterListener) -> Callable[[], None]:
        """Call `listener` for every parameter heard, until the function returned here is called."""
        key = object()
        self._listeners[key] = listener

        def unlisten() -> None:
            self._listeners.pop(key, None)

        return unlisten

    def hear(self, frame: Frame) -> None:
        """Store a PARAM_VALUE, including those of unknown type or with a value that is not a number."""
        heard = self._parameter(frame)
        if heard is None:
            return
        before = self._known.get(heard.name)
        if heard.index is None and before is not None:
            heard = replace(heard, index=before.index)
        self._known[heard.name] = heard
        for listener in list(self._listeners.values()):
            listener(heard, before)

    def _parameter(self, frame: Frame) -> Parameter | None:
        """Read a PARAM_VALUE, or None if it is PX4's hash or of a type this protocol does not carry."""
        heard = heard_value(frame, self.encoding)
        if heard is None:
            self.hash = param_bytes(frame)
            return None
        if heard.index is not None:
            self.count = heard.count
        if heard.kind is None:
            return None
        return Parameter(heard.name, heard.value, heard.kind, heard.index, heard.bits)

    def forget(self) -> None:
        """Forget every value, since the vehicle has restarted."""
        self._known.clear()
        self.count = self.hash = None

    async def read(self, name: str) -> Parameter:
        """Ask for one parameter by name; hidden ones answer too.

        Silence alone may be loss, so a parameter that exists is asked for right behind it. The silence of this one
        counts only where that one is answered: answers come in the order of the questions. How many silences it takes
        depends on how many answers were lost before: see :meth:`Pace.silences`.

        Raises
        ------
        ParameterMissing
            If the vehicle answers, but not to this name.
        ParameterTimeout
            If the link is too bad to tell, or the parameter was heard before.
        VehicleSilent
            If the heartbeat has ceased.
        """
        other = self._beside(name)
        busy = {name} if other is None else {name, other}
        self._asked.update(busy)
        try:
            return await self._read(name, other)
        finally:
            self._asked.subtract(busy)
            self._asked += Counter()

    def _beside(self, name: str) -> str | None:
        """Another parameter that exists, preferably one that no other reader is asking for."""
        others = [known for known in self._known if known != name]
        return next((known for known in others if known not in self._asked), next(iter(others), None))

    async def _read(self, name: str, other: str | None) -> Parameter:
        vehicle = self._vehicle

        def match(frame: Frame) -> Parameter | ParameterError | _Other | None:
            if frame.message_id == _ERROR:
                return _refusal(vehicle, frame, name)
            parameter = self._parameter(frame)
            if parameter is None or parameter.name == name:
                return parameter
            expected_too = parameter.name == other if other is not None else parameter.index == 0
            return _Other() if expected_too else None

        silences, proved = 0, False
        expected: Expectation[Parameter | ParameterError | _Other] = vehicle.waits.expect({_VALUE, _ERROR}, match)
        with expected as answer:
            for attempt in range(_MOST_TRIES):
                self._request(name)
                if attempt:
                    self._request(other)
                asked = vehicle.clock()
                until, others = asked + self._patience(READ_LEAST_S, attempt), 0
                got: Parameter | ParameterError | _Other | None = _Other()
                while isinstance(got, _Other) and vehicle.clock() < until:
                    got = await answer.within(until - vehicle.clock())
                    if isinstance(got, _Other) and attempt:
                        others += 1
                        until = min(until, vehicle.clock() + _GRACE_S)
                if isinstance(got, ParameterError):
                    raise got
                if isinstance(got, Parameter):
                    if not attempt:
                        vehicle.pace.answered(vehicle.clock() - asked)
                    for earlier in range(attempt + 1):
                        vehicle.pace.trip(answered=earlier == attempt)
                    return self._known.get(name, got)
                if attempt:
                    vehicle.pace.trip(answered=others > 0)
                silences += others > 0
                proved = silences >= vehicle.pace.silences()
                if proved:
                    break
        raise self._silence(name, proved=proved)

    def _silence(self, name: str, *, proved: bool) -> VehicleError:
        vehicle = self._vehicle
        if vehicle.silent:
            return VehicleSilent(f"{name} was not answered: no heartbeat any more. Check power and link.")
        if proved and name not in self._known:
            return ParameterMissing(f"This vehicle has no parameter {name}.", name=name)
        return ParameterTimeout(f"{name} was asked for repeatedly and not answered. Is the link too slow?", name=name)

    async def set(self, name: str, value: float, kind: ParamType | None = None) -> Echo:
        """Write one parameter and wait until the vehicle says that it holds exactly this value.

        Before every single PARAM_SET the vehicle must be writable (disarmed, landed, alive, not calibrating).

        Parameters
        ----------
        name, value
            REAL32 values are rounded to float32 first; the confirmation must have the same bits.
        kind
            None: the kind last heard (asked for if none was). A kind that contradicts the vehicle's is refused: PX4
            ignores such writes, or takes the bytes of one type for the other.

        Raises
        ------
        ParameterRejected
            The value cannot be sent, or the vehicle holds another one afterwards.
        ParameterMissing, ParameterTimeout, VehicleSilent
            It did not answer.
        VehicleArmed, VehicleBusy, VehicleConflict
            It may not be written to now. Each of these has ``sent``: how often PARAM_SET had left before it.
        """
        vehicle = self._vehicle
        kind = await self._kind(name, kind)
        encoding = self.encoding
        bits = bits_from_value(name, value, kind, encoding)

        def match(frame: Frame) -> Parameter | ParameterError | None:
            if frame.message_id == _ERROR:
                return _refusal(vehicle, frame, name)
            parameter = self._parameter(frame)
            if parameter is None or parameter.name != name or parameter.kind is not kind:
                return None
            return parameter if same_value(parameter.bits, bits, kind, encoding) else None

        message = param_set(vehicle.system, vehicle.component, name, bits, kind)
        sent = 0
        expected: Expectation[Parameter | ParameterError] = vehicle.waits.expect({_VALUE, _ERROR}, match, anywhere=True)
        settled: Echo | ParameterRejected
        for _ in range(_WAYS):
            way, tries = vehicle.way, 0
            with expected as answer:
                while tries < TRIES:
                    await self._transmit(message, name, sent)
                    sent, tries = sent + 1, tries + 1
                    got = await answer.within(self._patience())
                    if isinstance(got, ParameterError):
                        got.sent = sent
                        raise got
                    if got is not None:
                        self._note(got)
                        return Echo(got, sent)
            settled = await self._settle(name, value, bits, kind, sent)
            if isinstance(settled, Echo):
                return settled
            if vehicle.way == way:
                break  # else what was sent went into a link that is dead: the one that took its place is tried
        assert isinstance(settled, ParameterRejected)
        raise settled

    def _note(self, confirmed: Parameter) -> None:
        """Store a confirmed value, also if its echo came over a link that is not in use."""
        known = self._known.get(confirmed.name)
        if known is not None and known.bits != confirmed.bits:
            index = known.index if confirmed.index is None else confirmed.index
            self._known[confirmed.name] = replace(confirmed, index=index)

    async def _transmit(self, message: RawMessage, name: str, sent: int) -> None:
        """Send if the vehicle may be written to, by everything received until now, however late the loop is."""
        vehicle = self._vehicle
        try:
            await vehicle.caught_up()
            vehicle.require_writable(sent=sent, name=name)
            vehicle.send(message)
        except LinkDown as exc:
            error = VehicleSilent(f"{name} was sent {sent} times and not confirmed: {exc}")
            error.sent = sent
            raise error from exc

    async def _settle(
        self, name: str, value: float, bits: bytes, kind: ParamType, sent: int
    ) -> Echo | ParameterRejected:
        """Read the value back, because no echo came."""
        try:
            held = await self.read(name)
        except VehicleError as exc:
            exc.sent = sent
            raise
        if held.kind is kind and same_value(held.bits, bits, kind, self.encoding):
            return Echo(held, sent)
        return ParameterRejected(f"{name}: {value} was written, the vehicle holds {held.value}.", name=name, sent=sent)

    async def _kind(self, name: str, kind: ParamType | None) -> ParamType:
        known = self._known.get(name)
        if known is None and kind is None:
            known = await self.read(name)
        if known is not None and kind is not None and known.kind is not kind:
            raise ParameterRejected(
                f"{name} is of type {known.kind.name} on this vehicle and cannot be written as {kind.name}.", name=name
            )
        return kind if kind is not None else known.kind if known is not None else ParamType.REAL32

    def _request(self, name: str | None) -> None:
        """Ask for a parameter by name, or for the first of the list."""
        vehicle = self._vehicle
        encoded, index = (b"", 0) if name is None else (name.encode("ascii", "replace"), -1)
        vehicle.send(dialect.MAVLink_param_request_read_message(vehicle.system, vehicle.component, encoded, index))

    def _patience(self, least: float = ANSWER_S, attempt: int = 0) -> float:
        """Time to wait for an answer, longer with every attempt up to the usual time.

        It varies a little, so that two programs asking at once get out of step.
        """
        self._jitter = (self._jitter + 0.618) % 1.0
        known = self._vehicle.pace.patience(ANSWER_S, least)
        return max(known, min(known * 2.0**attempt, ANSWER_S)) + 0.3 * self._jitter * min(known, ANSWER_S)


def _refusal(vehicle: Addressee, frame: Frame, name: str) -> ParameterError | None:
    """The error that a PARAM_ERROR states (most firmwares send none)."""
    message = decode(frame)
    if message.param_id != name or message.target_system not in (0, vehicle.own.system):
        return None
    if message.error == _DOES_NOT_EXIST:
        return ParameterMissing(f"This vehicle has no parameter {name}.", name=name)
    meaning = _ERRORS.get(message.error, f"error {message.error}")
    return ParameterRejected(f"The vehicle refuses {name}: {meaning}.", name=name)
