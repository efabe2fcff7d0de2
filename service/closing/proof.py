"""Proof that a vehicle is a simulator, required before any command.

Until then the vehicle gets heartbeats and questions only, which change nothing in it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.simulated import StatedHardware, proofs_needed, why_no_simulator
from mavcal.calib.wire.codec import Message
from mavcal.service.closing import autopilot as ways
from mavcal.service.closing.errors import NoSimulator, SimulatorSilent
from mavcal.service.closing.link import VehicleLink, text_of
from mavcal.service.errors import LinkDown

ASK_S, ANSWER_S = 1.0, 20.0
"""Wall seconds between two questions, and for all answers. Chosen, not measured: a busy simulator answers in one."""
_VERSION = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_FIRMWARES = {dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot", dialect.MAV_AUTOPILOT_PX4: "px4"}


class SimulatorProof:
    """Asks the vehicle behind `link`, whose heartbeat was heard; `check` may raise meanwhile."""

    def __init__(self, link: VehicleLink, check: Callable[[], None]) -> None:
        assert link.heartbeat is not None
        self._link, self._check = link, check
        self._autopilot = _FIRMWARES.get(link.heartbeat.autopilot)
        self._stated: StatedHardware | None = None
        self._parameters: set[str] = set()

    def require(self) -> None:
        """Ask until the vehicle has shown that it is a simulator.

        Raises
        ------
        NoSimulator
            If something speaks against it, or the answers do not come.
        SimulatorSilent
            If the connection breaks.
        """
        end, asked = time.monotonic() + ANSWER_S, -math.inf
        try:
            while (why := self._why()) is not None and not self._decided and time.monotonic() < end:
                self._check()
                if time.monotonic() - asked > ASK_S:
                    asked = time.monotonic()
                    self._ask()
                for message in self._link.poll():
                    self._take(message)
        except LinkDown as error:
            self._check()
            raise SimulatorSilent(f"the connection broke before the vehicle said what it is: {error}") from error
        if why is not None:
            system, component = self._link.target
            raise NoSimulator(
                f"the vehicle {system}.{component} at {self._link.endpoint} does not show that it is a simulator: "
                f"{why}. Nothing was set, armed or moved. Give the simulator's own address by --connect, and take "
                "other vehicles off it"
            )

    def _why(self) -> str | None:
        return why_no_simulator(self._autopilot, self._stated, self._parameters)

    @property
    def _decided(self) -> bool:
        """Whether no further answer can prove it: the firmware is unknown, or runs on other hardware."""
        assumed = proofs_needed(self._autopilot)
        return self._autopilot is None or (
            self._stated is not None and why_no_simulator(self._autopilot, self._stated, assumed) is not None
        )

    def _ask(self) -> None:
        """Ask by the new message and the old one; each firmware knows at least one of them."""
        to = self._link.target
        self._link.send(ways.command(to, dialect.MAV_CMD_REQUEST_MESSAGE, _VERSION))
        self._link.send(ways.command(to, dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1.0))
        for name in proofs_needed(self._autopilot):
            self._link.send(dialect.MAVLink_param_request_read_message(*to, name.encode(), -1))

    def _take(self, message: Message) -> None:
        name = message.get_type()
        if name == "AUTOPILOT_VERSION":
            self._stated = StatedHardware(
                int(message.uid), int(message.board_version), int(message.vendor_id), int(message.product_id)
            )
        elif name == "PARAM_VALUE":
            self._parameters.add(text_of(message.param_id))
