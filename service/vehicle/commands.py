"""Commands: sending, acknowledgement, and a ban on dangerous ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CommandRefused, CommandTimeout, ForbiddenCommand, VehicleSilent
from mavcal.service.vehicle.exchange import Addressee

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS, CANCELLED = range(7)
REFUSED = (DENIED, UNSUPPORTED, FAILED)
"""Results that another attempt does not change."""
_RESULTS = {
    TEMPORARILY_REJECTED: "temporarily rejected: the vehicle is busy or armed; try again later",
    DENIED: "denied: it can not do this with these arguments, or not in its present state",
    UNSUPPORTED: "unsupported: this firmware does not know it",
    FAILED: "failed",
    CANCELLED: "cancelled",
    7: "only accepted as COMMAND_LONG",
    8: "only accepted as COMMAND_INT",
    9: "unsupported frame",
    10: "not in control of this vehicle",
}

CALIBRATION, STORAGE, REBOOT, ARM = 241, 245, 246, 400
RUN_PREARM_CHECKS, GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 401, 510, 511, 512
REQUEST_PROTOCOL_VERSION, REQUEST_CAPABILITIES = 519, 520
_START_LOGGING, _STOP_LOGGING = 2510, 2511
_MAG_CAL_START, _MAG_CAL_ACCEPT, _MAG_CAL_CANCEL = 42424, 42425, 42426

_HARMLESS = frozenset(
    {
        RUN_PREARM_CHECKS,
        GET_MESSAGE_INTERVAL,
        SET_MESSAGE_INTERVAL,
        REQUEST_MESSAGE,
        REQUEST_PROTOCOL_VERSION,
        REQUEST_CAPABILITIES,
        _START_LOGGING,
        _STOP_LOGGING,
        _MAG_CAL_START,
        _MAG_CAL_ACCEPT,
        _MAG_CAL_CANCEL,
    }
)
"""Commands allowed with any arguments. A command neither here nor in ``_RULES`` is not sent."""


def _calibration(params: Sequence[float]) -> str | None:
    gyro, magnetometer, pressure, radio, accelerometer, motors, other = params
    if motors:
        return "parameter 6 starts the motors (compassmot) and blocks the vehicle until it restarts"
    if pressure or radio or other:
        return "parameters 3, 4 and 7 calibrate what this software does not, and may block the vehicle"
    if gyro not in (0, 1) or magnetometer not in (0, 1, 76) or accelerometer not in (0, 1, 2, 4, 76):
        return "these arguments have no known meaning on both firmwares"
    if sum(bool(p) for p in params) > 1:
        return "it does one thing at a time"
    return None


def _storage(params: Sequence[float]) -> str | None:
    if params[0] != 1 or any(params[1:]):
        return "only saving (parameter 1 = 1) is allowed: the others load, reset or erase all parameters"
    return None


def _reboot(params: Sequence[float]) -> str | None:
    if params[0] != 1 or any(params[1:]):
        return "only a plain restart of the autopilot is allowed: no bootloader, no shutdown, no force"
    return None


def _disarm(params: Sequence[float]) -> str | None:
    if params[0] != 0 or any(params[1:]):
        return "this software never arms a vehicle, and never forces it"
    return None


_RULES = {CALIBRATION: _calibration, STORAGE: _storage, REBOOT: _reboot, ARM: _disarm}


def check_allowed(command_id: int, params: Sequence[float]) -> None:
    """Raise ForbiddenCommand for a command that can do harm; there is no override."""
    rule = _RULES.get(command_id)
    why = rule(params) if rule else None if command_id in _HARMLESS else "it is not among those that are needed"
    if why is not None:
        raise ForbiddenCommand(f"Command {command_id} {tuple(params)} is never sent: {why}.")


class Commanded(Addressee, Protocol):
    """A vehicle that takes commands."""

    def command_lock(self, command_id: int) -> AbstractAsyncContextManager[None]:
        """An acknowledgement names only the command: one of a kind at a time."""


async def command(
    vehicle: Commanded,
    command_id: int,
    params: Sequence[float] = (),
    *,
    timeout: float = 1.5,  # noqa: ASYNC109 - on the vehicle's clock, and restarted by IN_PROGRESS
    retries: int = 2,
) -> None:
    """Send a COMMAND_LONG and wait until it is accepted.

    Parameters
    ----------
    vehicle, command_id
        The vehicle, and the command (MAV_CMD).
    params
        Up to seven; missing ones are 0.
    timeout
        Seconds to wait for an answer; every IN_PROGRESS restarts them.
    retries
        How often an unanswered command is sent again. Use 0 for one that must not be executed twice.

    Raises
    ------
    CommandRefused
        For every MAV_RESULT but ACCEPTED; carries it.
    CommandTimeout
        If no acknowledgement came; whether it was executed is not known.
    VehicleSilent
        The same, of a vehicle whose heartbeat has ceased.
    ForbiddenCommand
        See :func:`check_allowed`.
    """
    full = [*map(float, params), *[0.0] * 7][:7]
    check_allowed(command_id, full)
    async with vehicle.command_lock(command_id):
        with vehicle.waits.expect({dialect.MAVLINK_MSG_ID_COMMAND_ACK}, _match(vehicle, command_id)) as answer:
            for confirmation in range(retries + 1):
                vehicle.send(
                    dialect.MAVLink_command_long_message(
                        vehicle.system, vehicle.component, command_id, confirmation, *full
                    )
                )
                result = await answer.within(timeout)
                while result == IN_PROGRESS:
                    result = await answer.within(timeout)
                    if result is None:
                        raise _unanswered(vehicle, command_id, "it began, but its end was not heard")
                if result is not None:
                    return _judge(command_id, result)
        raise _unanswered(vehicle, command_id, f"asked {retries + 1} times, no acknowledgement")


def _match(vehicle: Addressee, command_id: int) -> Callable[[Frame], int | None]:
    own = vehicle.own

    def match(frame: Frame) -> int | None:
        ack = decode(frame)
        ours = ack.target_system in (0, own.system) and ack.target_component in (0, own.component)
        return int(ack.result) if ack.command == command_id and ours else None

    return match


def _judge(command_id: int, result: int) -> None:
    if result != ACCEPTED:
        meaning = _RESULTS.get(result, f"result {result}")
        raise CommandRefused(f"Command {command_id} was {meaning}.", command=command_id, result=result)


def _unanswered(vehicle: Addressee, command_id: int, why: str) -> CommandTimeout | VehicleSilent:
    if vehicle.silent:
        return VehicleSilent(f"Command {command_id}: {why}; the vehicle has fallen silent.")
    return CommandTimeout(f"Command {command_id}: {why}, although the vehicle is there.")
