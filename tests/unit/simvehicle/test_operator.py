"""The operator of a simulated vehicle does what a prompt says, and with his hands only where it asks for hands."""

from __future__ import annotations

from typing import Any

import pytest

from mavcal.calib.procedures.protocol import Pose, Prompt, PromptStep
from mavcal.calib.report import to_json
from mavcal.service.simvehicle.operator import Operator


class Vehicle:
    """Notes what it is asked for."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []

    def call(self, do: str, **options: Any) -> dict[str, Any]:
        self.asked.append((do, options))
        return {}


def follow(*prompts: Prompt) -> list[tuple[str, dict[str, Any]]]:
    vehicle = Vehicle()
    operator = Operator(vehicle)
    for prompt in prompts:
        operator.follow(to_json(prompt))
    return vehicle.asked


@pytest.mark.parametrize("step", [PromptStep.HOLD_STILL, PromptStep.PLACE])
def test_what_lies_on_a_surface_does_not_tremble(step: PromptStep) -> None:
    """A level job that finds no rest before its first prompt would never find one in trembling hands."""
    asked = follow(Prompt(step, "Put it down.", Pose.LEVEL), Prompt(step, "At rest.", Pose.LEVEL, stable=True))
    assert asked == [("hold", {"pose": "level", "tilt_deg": 0.0, "tremor_deg": 0.0})]


def test_a_pose_is_held_in_the_hands() -> None:
    [(do, options)] = follow(Prompt(PromptStep.POSE, "Hold it.", Pose.LEVEL, remaining=(Pose.LEVEL,)))
    assert (do, options) == ("hold", {"pose": "level"})


def test_a_rest_that_asks_for_no_pose_moves_nothing() -> None:
    assert follow(Prompt(PromptStep.HOLD_STILL, "Wait.")) == []
