"""What the conversation with a simulated vehicle takes for a fault: a clock that stands still, and one that falls."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.closing.conversation import Conversation
from mavcal.service.closing.errors import MissionLeft, SimulatorSilent


class Link:
    """Gives one message at each look; the last one again and again."""

    def __init__(self, times_ms: Iterable[int]) -> None:
        self.heartbeat = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3)
        self.target = (1, 1)
        self._times = list(times_ms)

    def poll(self) -> list[Any]:
        ms = self._times.pop(0) if len(self._times) > 1 else self._times[0]
        return [dialect.MAVLink_attitude_message(ms, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)]

    def send(self, _message: Any) -> None:
        """Nobody listens."""


def begun(*times_ms: int) -> Conversation:
    vehicle = Conversation(Link(times_ms), lambda: None, lambda *_: None)  # type: ignore[arg-type]
    vehicle.begin()
    return vehicle


def test_a_clock_that_stands_still_is_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mavcal.service.closing.conversation.SILENT_S", 0.05)
    with pytest.raises(SimulatorSilent, match=r"no newer state for 0\.05 s"):
        begun(1000, 1020).run(1.0)


def test_a_clock_that_falls_is_a_restart() -> None:
    with pytest.raises(MissionLeft, match="the vehicle restarted 4 s into the mission"):
        begun(1000, 5000, 4990, 30).run(60.0)
