"""What the demonstration says where the service or the vehicle stops answering: a reason, never a traceback."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from mavcal.client import Unreachable
from mavcal.client.problems import VehicleArmed, VehicleSilent
from mavcal.service.commands.demo import command
from mavcal.service.demo import run as demo
from mavcal.service.simvehicle import ControlError


@pytest.mark.parametrize(
    "error", [Unreachable("no answer within 30 s"), ControlError("no answer"), FileNotFoundError("x")]
)
def test_whoever_does_not_answer_is_the_reason(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(demo, "_run", fails)
    done = CliRunner().invoke(command, ["--seed", "3", "--json"], standalone_mode=False)
    told = json.loads(done.stdout)
    assert told["ok"] is False
    assert told["reasons"] == [f"{type(error).__name__}: {error}"]
    assert done.return_value == 1


def test_a_vehicle_that_is_late_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo.time, "sleep", lambda _s: None)
    refusals = [VehicleArmed(409, {}), VehicleSilent(503, {})]

    def ask() -> str:
        if refusals:
            raise refusals.pop()
        return "started"

    assert demo._when_ready(ask) == "started"


def test_a_vehicle_that_stays_silent_is_not_asked_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "READY_S", -1.0)

    def ask() -> None:
        raise VehicleSilent(503, {})

    with pytest.raises(VehicleSilent):
        demo._when_ready(ask)
