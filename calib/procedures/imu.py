"""Accelerometers and gyros together, from poses held by hand and the movements between them (METHODS 3.3).

The poses are those of the job ``accel``. The gyro transfers the direction of gravity from each to the next. That gives
its scale and cross axes, and a better accelerometer fit than poses alone. A rest comes first: with hand tremor the
gyro's offset would be ten times less certain. Tremor also limits the scale, by half a degree in every movement: a
vehicle leant on something instead of held gives a tenth of a percent.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from mavcal.calib.firmware.storable import INERTIAL
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.gyro.rest import fit_gyro_rest
from mavcal.calib.imu import fit_imu
from mavcal.calib.option import Option
from mavcal.calib.procedures.accel import EXTRA, AccelProcedure
from mavcal.calib.procedures.base import mean_temperature, refusals
from mavcal.calib.procedures.body_frame import in_body, in_sensor
from mavcal.calib.procedures.motion import RESTING, StillWatch
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.pose_fit import Assessment
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel, drift_sd_deg_per_min

SPEC = ProcedureSpec(
    kind="imu-multi",
    title="Accelerometers and gyros together from poses and the movements between",
    sensors=(Sensor.ACCEL, Sensor.GYRO),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option(
            "uncertainty", float, 0.005, "standard deviation to reach on every axis of every offset", "m/s2", 5e-4, 0.1
        ),
        Option("scale", float, 2.0, "standard deviation to reach of the gyros' scale", "%", 0.02, 5.0),
        Option("obliques", float, 6.0, "oblique poses to ask for beside the six faces", "", 4.0, 18.0),
        Option("patience", float, 180.0, "gives up after this time without a new pose", "s", 20.0, 3600.0),
    ),
    needs="the vehicle, propellers off, at rest, then held still on its six faces and in six oblique "
    "poses, turned in between",
    ends_on="standard deviation of every accelerometer offset (0.005 m/s2) and gyro scale (2 %), poses that agree",
    autopilots=INERTIAL,
    duration_s=75.0,
)
REST_S = 6.0
"""Rest that is taken first, s."""


class ImuProcedure(AccelProcedure):
    """Guides through the poses like the accelerometer job, keeps every sample, and fits both sensors jointly."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._scale_target = 0.01 * float(options["scale"])
        self._pool = Pool((Sensor.ACCEL, Sensor.GYRO, Sensor.TEMPERATURE))
        self._rest_begun: float | None = None
        self._rest: tuple[float, float] | None = None

    def _on_start(self, present: set[Instance]) -> None:
        self._quiet = StillWatch(RESTING, present)
        super()._on_start(present)
        self._show(_REST)
        self._gyro_body = self.bodies(Sensor.GYRO)

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        self._pool.add(frame)
        if self._rest is None:
            self._wait_for_rest(start, end, frame)
        else:
            super()._on_tick(start, end, frame)

    def _ask(self, direction: Array | None, *, stable: bool) -> None:
        if self._rest is not None:
            super()._ask(direction, stable=stable)

    def _on_dropout(self, instance: Instance) -> None:
        super()._on_dropout(instance)
        self._quiet.drop(instance)

    def _wait_for_rest(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._quiet.update(frame)
        if not verdict.counted:
            self._rest_begun = None
        elif self._rest_begun is None:
            self._rest_begun = start
        lasted = 0.0 if self._rest_begun is None else end - self._rest_begun
        if self._rest_begun is not None and lasted >= REST_S:
            # the last tick may hold the beginning of a movement that is not noticed yet
            self._rest = self._rest_begun, start
            self._last_taken = end
            self._ask(None, stable=False)
            return
        self._show(dataclasses.replace(_REST, stable=verdict.counted))
        if self.elapsed >= self.options["patience"]:
            self._give_up(
                f"no rest within {self.elapsed:.0f} s: {verdict.why or 'too short'}", "put it down and let go"
            )
            return
        text = f"at rest for {lasted:.0f} s" if verdict.still else verdict.why
        self._report(Progress(0.0, float(len(self._left())), "poses", text, None, {"rest_s": lasted}))

    def _end(self, assessment: Assessment) -> None:
        """Once the poses agree, fit jointly, and continue with poses until the gyros are determined too."""
        paired = [i for i in self.present(Sensor.ACCEL) if i in self.present(Sensor.GYRO)]
        fits = [fit for i in paired for fit in self._fit(i)]
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        reached = max((_scale_sd(f) for f in usable if f.sensor == Sensor.GYRO), default=math.inf)
        offset = max((_offset_sd(f) for f in usable if f.sensor == Sensor.ACCEL), default=math.inf)
        if reached <= self._scale_target and offset <= self._target:
            self._done(fits, f"{assessment.short}; the gyros' scale is known to {100.0 * reached:.3f} % or better")
        elif self._wanted < int(self.options["obliques"]) + EXTRA:
            self._wanted += 1
            self._note = "A further pose is needed: turn it there about another axis than before. "
        else:
            why = refusals(fits) if not usable else f"the gyros' scale is known to {100.0 * reached:.2f} %"
            self._give_up(
                f"{len(self._poses)} poses do not reach the goal: {why}, not to {100.0 * self._scale_target:.2f} %",
                "turn it further and more briskly from pose to pose, about all axes, or ask for less",
            )

    def _fit(self, instance: int) -> tuple[FitResult, FitResult]:
        accel_body, gyro_body = self._body[instance], self._gyro_body[instance]
        temperature = mean_temperature(self._pool, instance)
        means = [pose.means[instance] for pose in self._poses if instance in pose.means]
        accel, gyro = fit_imu(
            in_body(self._pool.channel((Sensor.ACCEL, instance)), accel_body),
            in_body(self._pool.channel((Sensor.GYRO, instance)), gyro_body),
            gravity=self.context.gravity,
            spans=np.array([*([] if self._rest is None else [self._rest]), *((m.start, m.end) for m in means)]),
            temperature=temperature,
            relative=self.context.relative,
        )
        return in_sensor(accel, accel_body), self._with_rest(in_sensor(gyro, gyro_body), temperature)

    def _with_rest(self, gyro: FitResult, temperature: float | None) -> FitResult:
        """The fit with the offset from the rest, if that is more accurate than from the hand-held poses."""
        assert self._rest is not None
        rest = fit_gyro_rest(
            self._pool.channel((Sensor.GYRO, gyro.instance)).between(*self._rest),
            accel=self._pool.channel((Sensor.ACCEL, gyro.instance)).between(*self._rest),
            temperature=temperature,
            relative=self.context.relative,
        )
        if FitStatus.REFUSED in (rest.status, gyro.status) or not (rest.sd[:3] < gyro.sd[:3]).all():
            return gyro
        covariance = gyro.covariance.copy()
        covariance[:3, 3:] = covariance[3:, :3] = 0.0
        covariance[:3, :3] = rest.covariance[:3, :3]
        model = TriadModel(rest.model.offset, gyro.model.matrix)
        drift = drift_sd_deg_per_min(model, covariance)
        quality = {**gyro.quality, "attitude_sd_deg_per_min": drift, "offset_of": "rest"}
        return dataclasses.replace(gyro, model=model, covariance=covariance, quality=quality)

    def _done(self, fits: list[FitResult], because: str) -> None:
        self._dropped_rows()
        for instance in set(self.present(Sensor.ACCEL)) - set(self.present(Sensor.GYRO)):
            self._leave_out((Sensor.ACCEL, instance), "the vehicle sends no samples of its gyro")
        self._succeed(fits, because)


_REST = Prompt(
    PromptStep.PLACE, "Put the vehicle down level on a firm surface and leave it alone.", Pose.LEVEL, hold_s=REST_S
)


def _scale_sd(fit: FitResult) -> float:
    names = [f"matrix_{a}{a}" for a in "xyz"]
    return max(float(fit.sd[3 + 4 * j]) if fit.determined(name) else math.inf for j, name in enumerate(names))


def _offset_sd(fit: FitResult) -> float:
    sd = fit.sd[:3]
    return math.inf if not fit.determined("offset_x", "offset_y", "offset_z") else float(sd.max())
