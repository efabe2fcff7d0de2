"""The exchange with one vehicle: its state on its own clock, and setpoints that are repeated."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import Message
from mavcal.service.closing import autopilot as ways
from mavcal.service.closing.errors import MissionLeft, SimulatorSilent, SimulatorUnarmed
from mavcal.service.closing.link import VehicleLink, text_of
from mavcal.service.errors import LinkDown

ATTITUDE_HZ, POSITION_HZ = 50.0, 25.0
SILENT_S = 20.0
"""Time without a newer state after which the vehicle counts as hung, wall seconds. Chosen, not measured."""
RESTARTED_S = 1.0
"""Backward step of the vehicle's clock that means a restart, s. Chosen, not measured: messages overtake each other by
less."""
TRY_S = 1.0
"""Vehicle seconds between two tries."""
_STREAMS_S = 2.0
_TRIM_S = 1.0
_TEXTS = 8
HINT = "Run the simulator by hand and look at it."


@dataclass
class VehicleState:
    """Last state: time since boot (s), height (m), attitude and its mean over a second (rad)."""

    t: float = 0.0
    height: float = 0.0
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0)
    trim: tuple[float, float] = (0.0, 0.0)
    armed: bool = False
    mode: int = -1


class Conversation:
    """Exchange with the vehicle behind `link`, whose heartbeat was heard.

    `check` raises if the simulator has ended; `on_progress` gets the seconds since the beginning and the activity.
    """

    def __init__(self, link: VehicleLink, check: Callable[[], None], on_progress: Callable[[float, str], None]) -> None:
        assert link.heartbeat is not None
        self._link, self._check, self._on_progress = link, check, on_progress
        self.to = link.target
        self.way = ways.autopilot_of(link.heartbeat)
        self.state = VehicleState()
        self.doing = "connecting"
        self.flying = False
        """Whether it must stay armed and in the expected mode."""
        self.obeys = self.way.guided
        """The expected mode."""
        self.listeners: list[Callable[[Message], None]] = []
        """Hear every message after the conversation itself."""
        self._texts: deque[str] = deque(maxlen=_TEXTS)
        self._parameters: dict[str, float] = {}
        self._heard = time.monotonic()
        self._began = 0.0

    def begin(self) -> None:
        """Ask for the vehicle's state until it comes. Raises SimulatorSilent if it does not."""
        streams = (
            (dialect.MAVLINK_MSG_ID_ATTITUDE, ATTITUDE_HZ),
            (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, POSITION_HZ),
        )
        self._heard, asked = time.monotonic(), -math.inf
        while not self.state.t:
            if time.monotonic() - asked > _STREAMS_S:
                asked = time.monotonic()
                for number, hz in streams:
                    self.send(ways.command(self.to, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / hz))
            self._listen()
        self._began = self.state.t

    def _listen(self) -> None:
        """Take in what has arrived."""
        self._check()
        if time.monotonic() - self._heard > SILENT_S:
            raise SimulatorSilent(
                f"the vehicle has sent no newer state for {SILENT_S:g} s, {self.where()}.{self.said()} {HINT}"
            )
        try:
            for message in self._link.poll():
                self._take(message)
        except LinkDown as error:
            self._broken(error)

    def pump(self) -> None:
        """Listen until the vehicle's clock has moved.

        Raises
        ------
        SimulatorSilent
            If it does not move any more.
        MissionLeft
            If the vehicle does something else than it is told.
        """
        before = self.state.t
        while self.state.t == before:
            self._listen()
        self._on_progress(self.state.t - self._began, self.doing)

    def _broken(self, error: LinkDown) -> None:
        self._check()  # a simulator that has ended is the better reason
        raise SimulatorSilent(f"the connection broke {self.where()}: {error}.{self.said()} {HINT}") from error

    def _take(self, message: Message) -> None:
        state, name = self.state, message.get_type()
        if name == "ATTITUDE":
            self._move_on(message.time_boot_ms)
            state.euler = (message.roll, message.pitch, message.yaw)
        elif name == "LOCAL_POSITION_NED":
            self._move_on(message.time_boot_ms)
            state.height = -message.z
        elif name == "HEARTBEAT":
            state.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
            state.mode = int(message.custom_mode)
            if self.flying:
                self._still_ours()
        elif name == "STATUSTEXT":
            self._texts.append(text_of(message.text))
        elif name == "PARAM_VALUE":
            self._parameters[text_of(message.param_id)] = float(message.param_value)
        for listen in self.listeners:
            listen(message)

    def _move_on(self, ms: int) -> None:
        state, t = self.state, 1e-3 * ms
        if t < state.t - RESTARTED_S:
            raise MissionLeft(f"the vehicle restarted {self.where()}.{self.said()} {HINT}")
        if t != state.t:  # a clock that stands still is silence: physics may hang behind a link that answers
            self._heard = time.monotonic()
        share = min(max((t - state.t) / _TRIM_S, 0.0), 1.0)
        roll, pitch = state.trim
        state.trim = roll + share * (state.euler[0] - roll), pitch + share * (state.euler[1] - pitch)
        state.t = t

    def _still_ours(self) -> None:
        if not self.state.armed:
            raise MissionLeft(f"the vehicle disarmed in the air {self.where()}: it has crashed.{self.said()} {HINT}")
        if self.state.mode != self.obeys:
            raise MissionLeft(
                f"the vehicle left the mode in which it is flown ({self.obeys}) for {self.state.mode}, "
                f"{self.where()}.{self.said()} Look for a failsafe."
            )

    def where(self) -> str:
        """Position in the mission, in words."""
        return f"{self.state.t - self._began:.0f} s into the mission ({self.doing})"

    def said(self) -> str:
        """The vehicle's last texts as a sentence with a leading space; empty if there were none."""
        return f" It said: {'; '.join(self._texts)}." if self._texts else " It said nothing in words."

    def send(self, message: Message) -> None:
        """Send one message."""
        try:
            self._link.send(message)
        except LinkDown as error:
            self._broken(error)

    def run(
        self,
        seconds: float,
        target: Callable[[], Message] | None = None,
        every: float = TRY_S,
        until: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Repeat a message for `seconds` of the vehicle's clock; True as soon as `until` is true."""
        begin, last = self.state.t, -math.inf
        while self.state.t < begin + seconds:
            if until():
                return True
            if target is not None and self.state.t - last >= every:
                last = self.state.t
                self.send(target())
            self.pump()
        return until()

    def parameter(self, name: str, otherwise: float) -> float:
        """Value of a parameter of the vehicle; `otherwise` if it does not answer."""
        request = dialect.MAVLink_param_request_read_message(*self.to, name.encode(), -1)
        self.run(2 * TRY_S, lambda: request, until=lambda: name in self._parameters)
        return self._parameters.get(name, otherwise)

    def stop_logging(self) -> None:
        """Tell the vehicle to stop logging, so that a logger that is behind can catch up."""
        for name, value in self.way.quiet.items():
            real = dialect.MAV_PARAM_TYPE_REAL32
            self.send(dialect.MAVLink_param_set_message(*self.to, name.encode(), value, real))

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter. Raises SimulatorUnarmed if the vehicle does not take it."""
        self.doing = f"setting {name}"
        self._parameters.pop(name, None)
        request = dialect.MAVLink_param_set_message(*self.to, name.encode(), value, dialect.MAV_PARAM_TYPE_REAL32)
        self.run(4 * TRY_S, lambda: request, until=lambda: name in self._parameters)
        answer = self._parameters.get(name)
        if answer is None or not math.isclose(answer, value, rel_tol=1e-5, abs_tol=1e-9):
            raise SimulatorUnarmed(
                f"the vehicle did not take {name} {value:g} over MAVLink (it answered {answer}). Has this simulator "
                "such a parameter? Where it reads a file, give it {params}"
            )
