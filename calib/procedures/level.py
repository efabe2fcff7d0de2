"""Roll and pitch of the flight controller against a level surface, from the corrected accelerometers at rest."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.firmware.limits import TRIM_MAX_RAD
from mavcal.calib.firmware.storable import LEVEL
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure
from mavcal.calib.procedures.holds import Hold
from mavcal.calib.procedures.motion import StillnessVerdict
from mavcal.calib.procedures.poses import angle, down
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.stats.stillness import PoseMean
from mavcal.calib.triad import TriadModel

SPEC = ProcedureSpec(
    kind="level",
    title="Level trim",
    sensors=(Sensor.ACCEL, Sensor.GYRO),
    still_only=(Sensor.GYRO,),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option("uncertainty", float, 0.05, "standard deviation of roll and pitch to reach", "deg", 0.005, 1.0),
        Option("patience", float, 120.0, "gives up after this time without rest", "s", 10.0, 3600.0),
    ),
    needs="the vehicle level, at rest on a level surface, with calibrated accelerometers",
    ends_on="standard deviation of roll and pitch (0.05 deg), three seconds at least",
    autopilots=LEVEL,
    duration_s=6.0,
)

SHORTEST = 3.0
"""Least time at rest, s."""

GRAVITY_WITHIN = 0.3
"""Largest deviation of a calibrated accelerometer at rest from gravity, m/s2; more tilts the level by degrees."""

UNITS_WITHIN = math.radians(1.0)
"""Difference between units of one board, rad, above which a warning is given."""


class LevelProcedure(TickedProcedure):
    """Waits for rest and takes the mean direction of gravity of every corrected accelerometer."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = math.radians(options["uncertainty"])
        self._hold = Hold()
        self._why = "no samples yet"
        self._restless = self._judge_at = 0.0

    def _on_start(self, present: set[Instance]) -> None:
        models = {i: self.context.in_force(Sensor.ACCEL, i) for i in self.present(Sensor.ACCEL)}
        self._models = {i: m for i, m in models.items() if m is not None}
        for instance in models.keys() - self._models.keys():
            self._leave_out((Sensor.ACCEL, instance), "its present calibration could not be read")
        if not self._models:
            self._give_up(
                "the calibration in force of no accelerometer is known",
                "read the vehicle's parameters, then start again",
            )
        self._show(_PROMPT)

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        if not verdict.still:
            self._hold, self._why, self._judge_at = Hold(), verdict.why, 0.0
            self._restless += end - start
            self._show(
                Prompt(PromptStep.HOLD_STILL, f"Not at rest: {verdict.what}. Leave the vehicle alone.", Pose.LEVEL)
            )
        elif verdict.counted:
            self._show(Prompt(PromptStep.HOLD_STILL, "At rest: leave the vehicle alone.", Pose.LEVEL, stable=True))
            self._hold.add(frame, end - start)
            if self._hold.seconds >= SHORTEST and self._hold.seconds >= self._judge_at:
                self._judge_at = self._hold.seconds + 1.0
                self._judge()
        if self.outcome is None:
            self._update_prompt(verdict)

    def _judge(self) -> None:
        held = {i: self._hold.mean(i) for i in self._models if i in self.present(Sensor.ACCEL)}
        means = {i: m for i, m in held.items() if m is not None and self._correctable(i, m)}
        if means:
            self._check(means)
        if not means or self.outcome is not None:
            return
        fits = tuple(_fit(i, self._models[i], m) for i, m in means.items())
        reached = max(max(f.native["roll_sd"], f.native["pitch_sd"]) for f in fits)
        if reached > self._target:
            self._why = f"roll and pitch are known to {math.degrees(reached):.3f} deg"
            return
        self._dropped_rows()
        first = fits[0].quality
        text = f"roll {first['roll_deg']:.2f}, pitch {first['pitch_deg']:.2f} deg"
        self._succeed(fits, f"{text}, known to {math.degrees(reached):.3f} deg")

    def _correctable(self, instance: int, mean: PoseMean) -> bool:
        if self._models[instance].polynomial is None or mean.temperature is not None:
            return True
        self._leave_out((Sensor.ACCEL, instance), "its correction needs a temperature, and the vehicle sends none")
        return False

    def _check(self, means: dict[int, PoseMean]) -> None:
        forces = {i: self._models[i].apply(m.mean, m.temperature) for i, m in means.items()}
        for instance, force in forces.items():
            off = float(np.linalg.norm(force)) - self.context.gravity
            if abs(off) > GRAVITY_WITHIN:
                self._give_up(
                    f"{label(Sensor.ACCEL, instance)} reads {off:+.2f} m/s2 off gravity at rest: it is not calibrated",
                    "run the accelerometer job first",
                )
                return
        tilt = max(angle(down(f), np.array([0.0, 0.0, 1.0])) for f in forces.values())
        if tilt > TRIM_MAX_RAD:
            self._give_up(
                f"the vehicle is tilted by {math.degrees(tilt):.0f} deg; a level trim beyond 10 deg is refused",
                "put it upright on a level surface; if it stands level, set the board's orientation first",
            )
        first = next(iter(forces.values()))
        apart = max(angle(down(f), down(first)) for f in forces.values())
        if apart > UNITS_WITHIN:
            self._warn(f"the accelerometers differ by {math.degrees(apart):.1f} deg about what is level")

    def _update_prompt(self, verdict: StillnessVerdict) -> None:
        if self._restless >= self.options["patience"]:
            self._give_up(
                f"no rest within {self._restless:.0f} s: {self._why}",
                "put the vehicle on a firm, level surface and leave it alone",
            )
            return
        text = f"at rest for {self._hold.seconds:.0f} s" if verdict.still else self._why
        eta = max(SHORTEST - self._hold.seconds, 0.0)
        self._report(Progress(min(self._hold.seconds, SHORTEST), SHORTEST, "s", text, eta))

    def _missing(self) -> tuple[str, str]:
        return (
            f"the vehicle was at rest for {self._hold.seconds:.1f} s ({self._why or 'not long enough'})",
            f"leave it alone for {SHORTEST:.0f} s or more",
        )


_PROMPT = Prompt(PromptStep.HOLD_STILL, "Put the vehicle level on a level surface and do not touch it.", Pose.LEVEL)


def roll_pitch(force: Array) -> tuple[float, float]:
    """Roll and pitch (rad) of a body at rest whose corrected accelerometer reads `force`.

    ``force = (g sin pitch, -g cos pitch sin roll, -g cos pitch cos roll)``.
    """
    x, y, z = (float(v) for v in force)
    return math.atan2(-y, -z), math.atan2(x, math.hypot(y, z))


def _fit(instance: int, model: TriadModel, mean: PoseMean) -> FitResult:
    """Roll and pitch as a fit: `native` in rad, `quality` in deg; the matrix turns the sensor level."""
    force = model.apply(mean.mean, mean.temperature)
    covariance = model.matrix @ mean.covariance @ model.matrix.T
    roll, pitch = roll_pitch(force)
    gradient = _gradient(force)
    roll_sd, pitch_sd = (math.sqrt(float(row @ covariance @ row)) for row in gradient)
    native = {"roll": roll, "pitch": pitch, "roll_sd": roll_sd, "pitch_sd": pitch_sd}
    return FitBuilder("level", Sensor.ACCEL, instance, "m/s2", mean.n, temperature=mean.temperature).fitted(
        TriadModel(),
        np.zeros((12, 12)),
        message=f"board at roll {math.degrees(roll):.2f}, pitch {math.degrees(pitch):.2f} deg on the surface",
        n_used=mean.n,
        residual_rms=0.0,
        condition_number=1.0,
        quality={f"{name}_deg": math.degrees(value) for name, value in native.items()},
        native=native,
    )


def _gradient(force: Array) -> Array:
    """Derivative (2, 3) of roll and pitch with respect to the force."""
    x, y, z = (float(v) for v in force)
    across = math.hypot(y, z)
    square = x * x + across * across
    return np.array(
        [
            [0.0, z / across**2, -y / across**2],
            [across / square, -x * y / (across * square), -x * z / (across * square)],
        ]
    )
