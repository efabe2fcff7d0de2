"""Offsets of the accelerometers with one axis vertical: the mean, less gravity on that axis (METHODS S1).

The quickest method, and the least accurate: a tilt of the surface and an error of the scale look like offset. The scale
in force is kept, and the offset is the one for that scale.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from mavcal.calib.accel.poses import fit_one_axis
from mavcal.calib.firmware.storable import ACCEL_OFFSETS
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, share_of_information
from mavcal.calib.procedures.body_frame import in_body, in_sensor
from mavcal.calib.procedures.holds import Hold
from mavcal.calib.procedures.motion import StillnessVerdict
from mavcal.calib.procedures.poses import down_direction, facing
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.triad import TriadModel

SPEC = ProcedureSpec(
    kind="accel-one-axis",
    title="Accelerometer offsets with one axis vertical",
    sensors=(Sensor.ACCEL, Sensor.GYRO),
    still_only=(Sensor.GYRO,),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option("uncertainty", float, 0.005, "standard deviation of the mean to reach on every axis", "m/s2", 5e-4, 0.1),
        Option(
            "fixture_sd", float, 0.5, "how far from vertical the axis may be (one standard deviation)", "deg", 0.0, 10.0
        ),
        Option("patience", float, 120.0, "gives up after this time", "s", 10.0, 3600.0),
    ),
    needs="the vehicle at rest on a level surface, on any one of its six faces",
    ends_on="standard deviation of the mean reading of every axis (0.005 m/s2); the tilt of the surface comes on top",
    autopilots=ACCEL_OFFSETS,
    duration_s=8.0,
)

SHORTEST = 3.0
"""Least time at rest, s."""


class AccelOneAxisProcedure(TickedProcedure):
    """Waits for rest on any face and takes the mean of every accelerometer."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = float(options["uncertainty"])
        self._hold = Hold()
        self._why = "no samples yet"
        self._known = math.inf
        self._judge_at = SHORTEST

    def _on_start(self, present: set[Instance]) -> None:
        instances = self.present(Sensor.ACCEL)
        self._body = self.bodies(Sensor.ACCEL)
        models = {i: self.context.in_force(Sensor.ACCEL, i) for i in instances}
        self._models = {i: m for i, m in models.items() if m is not None}
        for instance in models.keys() - self._models.keys():
            self._leave_out((Sensor.ACCEL, instance), "its present scale could not be read")
        if not self._models:
            self._give_up("the scale in force of no accelerometer is known", "read the vehicle's parameters first")
        self._show(_PROMPT)

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        direction = down_direction(self._watch, self._body, self.present(Sensor.ACCEL))
        if not verdict.still or direction is None:
            weightless = "no accelerometer shows gravity"
            self._begin_again(verdict.why or weightless)
            self._show(dataclasses.replace(_PROMPT, text=f"Not at rest: {verdict.what or weightless}. {_PROMPT.text}"))
        elif verdict.counted:
            self._rest(frame, end - start, direction)
        if self.outcome is None:
            self._update_prompt(verdict)

    def _begin_again(self, why: str) -> None:
        self._hold, self._why, self._known, self._judge_at = Hold(), why, math.inf, SHORTEST

    def _rest(self, frame: TickChannels, seconds: float, direction: Array) -> None:
        at = facing(direction)
        if not at.square:
            self._begin_again(f"no axis is vertical: the nearest is {math.degrees(at.off):.0f} deg off")
            self._show(dataclasses.replace(_PROMPT, text=f"No axis is vertical. {_PROMPT.text}"))
            return
        self._show(
            Prompt(PromptStep.PLACE, "At rest: leave the vehicle alone.", at.face, detected=at.face, stable=True)
        )
        self._hold.add(frame, seconds)
        if self._hold.seconds >= self._judge_at:
            self._judge_at = self._hold.seconds + 1.0
            self._judge()

    def _judge(self) -> None:
        held = {i: self._hold.channel(Sensor.ACCEL, i) for i in self._models if i in self.present(Sensor.ACCEL)}
        given = {i: channel for i, channel in held.items() if channel is not None}
        fits = [self._fit(i, channel, 0.0) for i, channel in given.items()]
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        if not usable:
            self._why = next((f.message for f in fits), "no accelerometer is left")
            return
        self._known = max(float(f.sd[:3].max()) for f in usable)
        if self._known > self._target:
            return
        tilt = float(self.options["fixture_sd"])
        results = [self._fit(i, channel, tilt) for i, channel in given.items()]
        self._dropped_rows()
        self._warn("an error of the scale on the vertical axis is read as offset: the job accel tells them apart")
        text = f"means known to {self._known:.4f} m/s2"
        if tilt:
            level = self.context.gravity * math.radians(tilt)
            text += f"; a tilt of {tilt:g} deg makes that {level:.3f} m/s2 on the level axes"
        self._succeed(results, text)

    def _fit(self, instance: int, channel: Channel, tilt: float) -> FitResult:
        """The offset for the scale in force: ``mean - S^-1 g``."""
        body = self._body[instance]
        gravity = self.context.gravity
        fit = fit_one_axis(in_body(channel, body), gravity=gravity, fixture_sd=tilt, relative=self.context.relative)
        if fit.status == FitStatus.REFUSED:
            return fit
        scale = self._models[instance].matrix @ body.T
        true = np.array(fit.native["mean"]) - fit.model.offset
        offset = np.array(fit.native["mean"]) - np.linalg.solve(scale, true)
        fit = dataclasses.replace(fit, model=TriadModel(offset, scale))
        return in_sensor(fit, body, temperature=self._hold.temperature(instance))

    def _update_prompt(self, verdict: StillnessVerdict) -> None:
        if self.elapsed >= self.options["patience"]:
            self._give_up(f"not done within {self.elapsed:.0f} s: {self._missing()[0]}", self._missing()[1])
            return
        text = f"at rest for {self._hold.seconds:.0f} s" if verdict.still else self._why
        share = share_of_information(self._target, self._known)
        eta = max(SHORTEST - self._hold.seconds, 0.0)
        if math.isfinite(self._known):
            eta = max(self._hold.seconds * ((self._known / self._target) ** 2 - 1.0), 0.0)
            text += f"; means known to {self._known:.4f} m/s2"
        self._report(Progress(share, 100.0, "%", text, eta, {"rest_s": self._hold.seconds}))

    def _missing(self) -> tuple[str, str]:
        if math.isfinite(self._known):
            return f"the means are known to {self._known:.4f} m/s2, not to {self._target:.4f}", "let it rest longer"
        return (
            f"the vehicle was at rest for {self._hold.seconds:.1f} s ({self._why})",
            f"put it on a level surface on one of its faces and leave it alone for {SHORTEST + 2.0:.0f} s",
        )


_PROMPT = Prompt(
    PromptStep.PLACE,
    "Put the vehicle on a level surface on any one of its faces and do not touch it.",
    Pose.LEVEL,
)
