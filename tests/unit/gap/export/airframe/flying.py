"""ArduPilot's simulated multicopter, one step of it: forces and torques, written from AIRFRAME 4.1 for tests alone.

What a flight would show (thrust at full command, drag, gains, damping, trim) is measured on the forces. Nothing here
is taken from the code that it checks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

G = 9.80665
STOCK: dict[str, Any] = {
    "mass": 3.0, "diagonal_size": 0.35, "refSpd": 15.08, "refAngle": 45, "refVoltage": 12.09, "refCurrent": 29.3,
    "refAlt": 593, "refBatRes": 0.01, "maxVoltage": 12.6, "battCapacityAh": 0.0, "hoverThrOut": 0.39, "propExpo": 0.65,
    "refRotRate": 120, "pwmMin": 1000, "pwmMax": 2000, "spin_min": 0.15, "spin_max": 0.95, "slew_max": 150,
    "disc_area": 0.385, "mdrag_coef": 0.2, "bbdrag_coef": 1.0,
}  # fmt: skip
PLUS = ((90, 1), (-90, 1), (0, -1), (180, -1))
CROSS = ((45, 1), (-135, 1), (-45, -1), (135, -1))


class Simulated:
    """A vehicle of a frame's keys and parameters at the reference altitude, with a full battery that does not fall."""

    def __init__(
        self,
        frame: Mapping[str, Any],
        parameters: Mapping[str, float] | None = None,
        motors: tuple[tuple[float, int], ...] = PLUS,
    ) -> None:
        self.keys = {**STOCK, **frame}
        self.parameters = dict(parameters or {})
        for key, name in (("mass", "MASS"), ("mdrag_coef", "MDRAG"), ("bbdrag_coef", "BBDRAG")):
            self.keys[key] = self.parameters.get(f"SIM_FRM_{name}", self.keys[key])
        k = self.keys
        self.n = len(motors)
        self.rho = 1.225 * (1.0 - 2.25577e-5 * k["refAlt"]) ** 4.2559
        weight = k["mass"] * G
        wash = 2.0 * k["refCurrent"] * k["refVoltage"] / weight
        self.area = weight / (0.5 * self.rho * wash**2)
        self.fastest = wash / math.sqrt(k["hoverThrOut"])
        lean = math.radians(k["refAngle"])
        drag, pull = weight * math.tan(lean), weight / math.cos(lean)
        rotors = math.cos(lean) * k["mdrag_coef"] * k["refSpd"] * math.cos(lean)
        rotors *= math.sqrt(pull * self.rho * k["disc_area"])
        self.mdrag = k["mdrag_coef"] * min(1.0, drag / rotors if rotors else 1.0)
        self.area_cd = k["bbdrag_coef"] * max(0.0, drag - rotors) / (0.5 * self.rho * k["refSpd"] ** 2)
        d = k["diagonal_size"]
        self.places = np.array(
            [
                k.get(f"motor{i + 1}_position") or (d * math.cos(math.radians(a)), d * math.sin(math.radians(a)), 0.0)
                for i, (a, _) in enumerate(motors)
            ]
        )
        self.yaw = np.array([k.get(f"motor{i + 1}_yaw") or spin for i, (_, spin) in enumerate(motors)], dtype=float)
        ring = k["mass"] * (d / 2.0) ** 2
        self.inertia = np.array(k.get("moment_inertia") or (0.25 * ring, 0.25 * ring, 0.5 * ring))

    def thrusts(self, commands: Array) -> tuple[Array, Array]:
        """Thrust of each motor (N) at the firmware's commands 0..1, and the commands that reach the motors."""
        k = self.keys
        low, high = (k["pwmMin"] + (k["pwmMax"] - k["pwmMin"]) * k[name] for name in ("spin_min", "spin_max"))
        pulse = low + (high - low) * commands
        mask, factor = int(self.parameters.get("SIM_ENGINE_FAIL", 0)), self.parameters.get("SIM_ENGINE_MUL", 1.0)
        for i in range(self.n):
            if mask & (1 << i):
                pulse[i] = 1000.0 + factor * (pulse[i] - 1000.0)
        c = np.clip((pulse - low) / (high - low), 0.0, 1.0)
        e = k["propExpo"]
        speed = self.fastest * np.sqrt((1.0 - e) * c + e * c**2)
        return 0.5 * self.rho * self.area / self.n * speed**2, c

    def accelerations(self, commands: Array, velocity: Array, rates: Array) -> tuple[Array, Array]:
        """Specific force, m/s2, and angular acceleration, rad/s2, in body axes."""
        k = self.keys
        thrust, c = self.thrusts(np.array(commands, dtype=float))
        force, torque = np.zeros(3), np.zeros(3)
        for i in range(self.n):
            through = velocity + np.cross(rates, self.places[i])
            pull = np.array([0.0, 0.0, -thrust[i]])
            pull = pull - self.mdrag * math.sqrt(self.rho * k["disc_area"] / self.n * thrust[i]) * through
            force += pull
            torque += np.cross(self.places[i], pull)
            torque[2] += self.yaw[i] * c[i] * 0.05 * k["diagonal_size"] * thrust[i]
        force -= 0.5 * self.rho * self.area_cd * velocity * np.abs(velocity)
        turning = torque / self.inertia
        if k["refRotRate"] > 0.0:
            turning = turning - rates * math.radians(400.0) / k["refRotRate"]
        if self.parameters.get("SIM_TWIST_TIME", 0.0) > 0.0:
            turning = turning + np.array([self.parameters.get(f"SIM_TWIST_{a}", 0.0) for a in "XYZ"])
        return force / k["mass"], turning

    def hover(self) -> float:
        """The command of a sound vehicle at hover."""
        e = self.keys["propExpo"]
        return float(np.roots([e, 1.0 - e, -self.keys["hoverThrOut"]]).max()) if e else self.keys["hoverThrOut"]

    def shown(self) -> dict[str, float]:
        """What flights show, by the names of effects and their parameters; thrusts of motors at the hover command."""
        zero, step = np.zeros(3), 1e-6
        full, level = np.ones(self.n), np.full(self.n, self.hover())
        sound = Simulated(self.keys, self.parameters | {"SIM_ENGINE_MUL": 1.0}, ((0, 1),) * self.n)
        sound.places, sound.yaw, sound.inertia = self.places, self.yaw, self.inertia
        still = sound.accelerations(level, zero, zero)
        shown = {
            "thrust_scale.s": -sound.accelerations(full, zero, zero)[0][2],
            "slew": self.keys["slew_max"],
            "wash": 0.5 * self.rho * self.area / self.keys["mass"],
        }
        half = -sound.accelerations(0.5 * full, zero, zero)[0][2] / shown["thrust_scale.s"]
        shown["thrust_expo.expo"] = 2.0 - 4.0 * half  # (1-e)/2 + e/4
        slow, fast = (np.array([v, 0.0, 0.0]) for v in (step, 10.0))
        linear = -sound.accelerations(level, slow, zero)[0][0] / step
        shown["rotor_drag.c1"] = linear
        shown["body_drag.c2"] = (-sound.accelerations(level, fast, zero)[0][0] / 10.0 - linear) / 10.0
        for axis, name in enumerate("xyz"):
            turn = np.zeros(3)
            turn[axis] = step
            shown[f"angular_damping.{name}"] = -(sound.accelerations(level, zero, turn)[1] - still[1])[axis] / step
            shown[f"trim.{name}"] = still[1][axis]
        # gains: torque a difference of thrust over mass would make, with the arms of the motors alone
        spread = self.places - self.places.mean(axis=0)
        per_newton = {"x": np.abs(spread[:, 1]).max(), "y": np.abs(spread[:, 0]).max()}
        for axis, name in enumerate("xy"):
            shown[f"gain.{name}"] = shown["thrust_scale.s"] * self.keys["mass"] * per_newton[name] / self.inertia[axis]
        lever = 0.05 * self.keys["diagonal_size"] * np.abs(self.yaw).mean()
        shown["gain.z"] = shown["thrust_scale.s"] * self.keys["mass"] * lever / self.inertia[2]
        weak, _ = self.thrusts(level)
        well, _ = sound.thrusts(level)
        shown |= {f"motor{i + 1}": weak[i] / well[i] for i in range(self.n)}
        return shown
