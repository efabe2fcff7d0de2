"""The compass offsets of a vehicle that cannot be turned, from one rest at a known heading."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.firmware.storable import MAG
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.mag.fixed_yaw import KnownAttitude, fit_fixed_yaw
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, mean_temperature, refusals
from mavcal.calib.procedures.level import GRAVITY_WITHIN, roll_pitch
from mavcal.calib.procedures.motion import StillnessVerdict
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Channel, Sensor

SPEC = ProcedureSpec(
    kind="mag-fixed-yaw",
    title="Compass offset at one known heading, for a vehicle that cannot be turned",
    sensors=(Sensor.MAG, Sensor.GYRO, Sensor.ACCEL),
    aiding=(Sensor.GYRO, Sensor.ACCEL),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option("heading", float, None, "heading of the nose from true north, as it stands", "deg", 0.0, 360.0),
        Option("heading_sd", float, 2.0, "how well that heading is known (one standard deviation)", "deg", 0.1, 10.0),
        Option("seconds", float, 5.0, "length of the rest", "s", 2.0, 60.0),
        Option("patience", float, 60.0, "gives up after this time without rest", "s", 10.0, 3600.0),
    ),
    needs="the vehicle at rest outdoors, propellers off, its true heading and its position known, accelerometers "
    "calibrated, away from steel and magnets",
    ends_on="a rest of 5 s; the offset is as good as the heading that is given, soft iron stays as it is",
    autopilots=MAG,
    duration_s=8.0,
)


class MagFixedYawProcedure(TickedProcedure):
    """Waits for rest, and takes the mean of every compass."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._pool = Pool((Sensor.MAG, Sensor.ACCEL, Sensor.TEMPERATURE))
        self._rested = self._restless = 0.0
        self._why = "no samples yet"

    def _on_start(self, present: set[Instance]) -> None:
        if self.context.earth_field is None:
            self._give_up(
                "the position is not known, so the Earth's field there is not",
                "wait for a position fix, or start the service with the position of the place",
            )
            return
        self._accel = self.present(Sensor.ACCEL)[0]
        self._show(_PROMPT)

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        if not verdict.still:
            self._pool = Pool((Sensor.MAG, Sensor.ACCEL, Sensor.TEMPERATURE))
            self._rested, self._why = 0.0, verdict.why
            self._restless += end - start
            self._show(Prompt(PromptStep.HOLD_STILL, f"Not at rest: {verdict.what}. Leave the vehicle alone."))
        elif verdict.counted:
            self._show(Prompt(PromptStep.HOLD_STILL, "At rest: leave the vehicle alone.", stable=True))
            self._pool.add(frame)
            self._rested += end - start
            if self._rested >= self.options["seconds"]:
                self._conclude()
        if self.outcome is None:
            self._update_prompt(verdict)

    def _conclude(self) -> None:
        standing = self._standing()
        if standing is None:
            return
        fits = [self._fit(i, standing) for i in self.present(Sensor.MAG) if (Sensor.MAG, i) in self._pool]
        known = [f for f in fits if f is not None]
        if not any(f.status != FitStatus.REFUSED for f in known):
            self._give_up(f"no compass can be calibrated at one heading: {refusals(known)}", "take the job mag")
            return
        self._dropped_rows()
        good = max(float(f.quality["heading_here_sd_deg"]) for f in known)
        self._succeed(known, f"the heading is known to {good:.1f} deg as it stands; soft iron is kept")

    def _standing(self) -> KnownAttitude | None:
        """Attitude of the vehicle; None: the job has ended, since its accelerometer cannot determine it."""
        accel = self._pool.channel((Sensor.ACCEL, self._accel))
        model = self.context.in_force(Sensor.ACCEL, self._accel)
        if model is None:
            self._give_up(
                "the calibration of the accelerometer could not be read", "read the parameters, then start again"
            )
            return None
        force = model.apply(accel.values.mean(axis=0), mean_temperature(self._pool, self._accel))
        off = float(np.linalg.norm(force)) - self.context.gravity
        if abs(off) > GRAVITY_WITHIN:
            self._give_up(
                f"{label(Sensor.ACCEL, self._accel)} reads {off:+.2f} m/s2 off gravity at rest: it is not calibrated",
                "run the accelerometer job first",
            )
            return None
        roll, pitch = roll_pitch(force)
        heading, sd = (math.radians(float(self.options[name])) for name in ("heading", "heading_sd"))
        return KnownAttitude(roll, pitch, heading, sd)

    def _fit(self, instance: int, standing: KnownAttitude) -> FitResult | None:
        model = self.context.in_force(Sensor.MAG, instance)
        if model is None:
            self._leave_out((Sensor.MAG, instance), "its present calibration could not be read")
            return None
        channel = self._pool.channel((Sensor.MAG, instance))
        return fit_fixed_yaw(
            channel.values.mean(axis=0),
            _of_mean(channel),
            len(channel),
            model,
            standing,
            instance=instance,
            quantum=channel.quantum,
            field=self.context.earth_field,
            body_from_sensor=self.context.body_from_sensor(Sensor.MAG, instance),
            relative=self.context.relative,
        )

    def _update_prompt(self, verdict: StillnessVerdict) -> None:
        if self._restless >= self.options["patience"]:
            self._give_up(f"no rest within {self._restless:.0f} s: {self._why}", "leave the vehicle alone")
            return
        wanted = float(self.options["seconds"])
        text = f"at rest for {self._rested:.0f} s" if verdict.still else self._why
        self._report(Progress(min(self._rested, wanted), wanted, "s", text, max(wanted - self._rested, 0.0)))

    def _missing(self) -> tuple[str, str]:
        wanted = self.options["seconds"]
        return f"the vehicle was at rest for {self._rested:.1f} s", f"leave it alone for {wanted:.0f} s or more"


_PROMPT = Prompt(PromptStep.HOLD_STILL, "Leave the vehicle alone, nose to the heading that you gave.")


def _of_mean(channel: Channel) -> Array:
    """Covariance (3, 3) of the mean: its scatter, and a whole bin where all readings are the same."""
    scatter = np.atleast_2d(np.cov(channel.values.T)) / len(channel)
    return np.asarray(scatter + channel.quantum**2 / 12.0 * np.eye(3))
