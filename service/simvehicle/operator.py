"""Moves a simulated vehicle as a prompt asks the operator to.

Prompts are the plain data that the service sends: ``step``, ``pose``, ``remaining``, ``rotate``, ``direction`` …
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

FACES = ("level", "left", "right", "nose_down", "nose_up", "back")

HAND_DPS = 180.0
"""How fast a hand turns a vehicle to an attitude."""
LEAST_TURN_S = 0.2


class Movable(Protocol):
    """A simulated vehicle that takes requests."""

    def call(self, do: str, **options: Any) -> dict[str, Any]:
        """One request, and its reply."""


class Operator:
    """Holds, turns and warms one simulated vehicle.

    Args:
        vehicle: whom to move.
        warm_from, warm_to: degC of the warm-up.
        warm_tau_s: its time constant, vehicle seconds.
        tumble_dps: how fast the vehicle is turned for its compass.
        turntable_dps: the rate of its turntable, and of turns on a thread.
        ramp_tau_s: time constant with which it is brought to a wished temperature, vehicle seconds.
    """

    def __init__(
        self,
        vehicle: Movable,
        *,
        warm_from: float = 20.0,
        warm_to: float = 62.0,
        warm_tau_s: float = 100.0,
        tumble_dps: float = 45.0,
        turntable_dps: float = 45.0,
        ramp_tau_s: float = 30.0,
    ) -> None:
        self._vehicle = vehicle
        self._warm_up = {"start": warm_from, "end": warm_to, "tau_s": warm_tau_s}
        self._tumble_dps = tumble_dps
        self._turntable_dps = turntable_dps
        self._ramp_tau_s = ramp_tau_s
        self._turns: float = 0.0
        self._doing: object = None
        self._temperature: float | None = None

    def follow(self, prompt: Mapping[str, Any] | None) -> None:
        """Carry out `prompt`; None and repeated prompts change nothing.

        Raises:
            ControlError: the vehicle has gone.
        """
        if prompt is None:
            return
        if prompt["temperature"] not in (None, self._temperature):
            self._temperature = prompt["temperature"]
            now = self._vehicle.call("state")["temperatures"][0]
            self._vehicle.call("warm_up", start=now, end=self._temperature, tau_s=self._ramp_tau_s)
        if prompt["rotate"]:
            self._once("tumble", "tumble", rate_dps=self._tumble_dps)
        elif prompt["step"] == "turn" and prompt["axis"] is not None:
            self._turn(prompt["axis"], prompt["turns"])
        elif prompt["step"] == "place" or (prompt["step"] == "hold_still" and prompt["pose"] is not None):
            self._once(("place", prompt["pose"]), "hold", pose=prompt["pose"], tilt_deg=0.0, tremor_deg=0.0)
        elif prompt["step"] == "warm_up":
            self._once("warm_up", "warm_up", **self._warm_up)
        elif prompt["pose"] is not None or prompt["remaining"]:
            self._hold(prompt)
        elif prompt["step"] in {"hold_still", "confirm"} and self.turning:
            self._once("still", "still")

    def turn_to(self, attitude: Sequence[float]) -> None:
        """Bring the vehicle to an attitude (quaternion w x y z, body to NED) as fast as a hand does, and hold it there.

        Raises:
            ControlError: the vehicle has gone.
        """
        now = self._vehicle.call("state")["quaternion"]
        cosine = min(1.0, abs(sum(a * b for a, b in zip(now, attitude, strict=True))))
        turn_s = max(LEAST_TURN_S, math.degrees(2.0 * math.acos(cosine)) / HAND_DPS)
        self._vehicle.call("hold", pose=list(attitude), tilt_deg=0.0, transition_s=turn_s)
        self._doing = None

    def answer(self, prompt: Mapping[str, Any] | None) -> str | None:
        """Answer to `prompt`; None: it asks for no number."""
        number = None if prompt is None else prompt["number"]
        if number is None:
            return None
        return str({"rate": self._turntable_dps, "turns": self._turns}[number["name"]])

    def rest(self) -> None:
        """Put the vehicle down, level and untouched."""
        self._once("rest", "hold", pose=[0.0, 0.0, 0.0], tilt_deg=0.0, tremor_deg=0.0)

    def _hold(self, prompt: Mapping[str, Any]) -> None:
        wanted = prompt["pose"] or prompt["remaining"][0]
        if wanted in FACES:
            self._once(("hold", wanted), "hold", pose=wanted)
            return
        direction = prompt["direction"]
        if direction is not None:  # without one: hold on to what is being held
            self._once(("oblique", tuple(direction)), "hold", pose=_attitude(direction))

    @property
    def resting(self) -> bool:
        """Whether it was put down, or was never moved."""
        return self._doing in (None, "rest")

    @property
    def turning(self) -> bool:
        """Whether it tumbles or turns, until it is told otherwise."""
        return self._doing == "tumble" or (isinstance(self._doing, tuple) and self._doing[0] == "turn")

    def _turn(self, axis: Sequence[float], turns: float | None) -> None:
        """Turn on the turntable; with `turns`, that many on a thread, from rest to rest."""
        self._turns = turns or self._turns
        self._once(("turn", tuple(axis), turns), "turn", axis=list(axis), rate_dps=self._turntable_dps, turns=turns)

    def _once(self, what: object, do: str, **options: Any) -> None:
        if self._doing != what:
            self._vehicle.call(do, **options)
            self._doing = what


def _attitude(down: Sequence[float]) -> list[float]:
    """Roll, pitch and yaw (deg) in which the body direction `down` points to the ground.

    Down in the body is (-sin pitch, sin roll cos pitch, cos roll cos pitch).
    """
    x, y, z = down
    return [math.degrees(math.atan2(y, z)), math.degrees(math.atan2(-x, math.hypot(y, z))), 0.0]
