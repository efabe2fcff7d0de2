"""Hard and soft iron of the compasses, from turning the vehicle, and whether each is mounted as stated.

Coverage is judged by its effect on the heading error, not by a fraction of directions. A compass that averages over its
period is blurred by fast turns. The gyro shows by how much: mild blur is corrected, stronger blur left out. The
strength of the field is compared with the World Magnetic Model from the first second.
"""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.firmware.limits import COMPASS_OFFSET_MAX_UT
from mavcal.calib.firmware.storable import MAG
from mavcal.calib.firmware.stream.messages import COMPASS_WINDOW
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.blur import rates_during
from mavcal.calib.mag.orientation import MountingVerdict, OrientationResult, interpolated
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, share_of_information
from mavcal.calib.procedures.mag_track import BodyMotion, MagTrack
from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

SPEC = ProcedureSpec(
    kind="mag",
    title="Compass hard and soft iron by turning the vehicle",
    sensors=(Sensor.MAG, Sensor.GYRO, Sensor.ACCEL),
    aiding=(Sensor.GYRO, Sensor.ACCEL),
    helpful=(),
    options=(
        Option(
            "uncertainty", float, 0.3, "standard deviation of the heading to reach with every compass", "deg", 0.02, 5.0
        ),
        Option("patience", float, 240.0, "ends after this time in any case", "s", 20.0, 3600.0),
    ),
    needs="the vehicle, propellers off, turned slowly about all axes, outdoors, away from steel and "
    "magnets; accelerometers calibrated",
    ends_on="standard deviation of the heading of every compass (0.3 deg), and a mounting that gravity confirms",
    autopilots=MAG,
    duration_s=40.0,
)

SHORTEST = 10.0
"""Least length, s."""

LOOK_EVERY = 2.0
"""Interval, s, of updates of coverage and prediction."""

ADVISE_EVERY = 6.0
"""A new direction is advised at most this often, s: an operator needs time to follow."""

BACKOFF = 1.3
"""Growth factor of the time between fits that miss the goal, to bound the cost of a long job."""

FIELD_WITHIN = 0.2
"""Relative deviation of the field strength from the model that is reported at once."""

HARD_IRON_AFTER = 5.0
"""Time, s, for which the raw field must stay above the limit."""

USABLE = 3.0
"""Heading error, degrees, below which the operator may accept the present result."""

CONFIRM_MOUNTING = 30.0
"""Extra time, s, beyond the goal to determine the mounting."""


class MagProcedure(TickedProcedure):
    """Collects sharp samples of every compass until the heading is known as well as asked for."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = float(options["uncertainty"])
        self._window = COMPASS_WINDOW.get(context.identity.autopilot or "", 0.0)
        self._tracks: dict[int, MagTrack] = {}
        self._recent: list[TickChannels] = []
        self._looked = self._advised = self._next_fit = -math.inf
        self._reached_at: float | None = None
        self._text = "Turn the vehicle slowly about all its axes."
        self._direction: tuple[float, float, float] | None = None

    def _on_start(self, present: set[Instance]) -> None:
        self._inertial = self.present(Sensor.ACCEL)[0], self.present(Sensor.GYRO)[0]
        accel = self.context.in_force(Sensor.ACCEL, self._inertial[0])
        self._accel = accel or TriadModel()
        self._rotation = self._accel.rotation
        if self.context.earth_field is None:
            self._warn("the place is not known: the field strength cannot be judged, and the common scale is not set")
        self._ask()

    def _on_dropout(self, instance: Instance) -> None:
        super()._on_dropout(instance)
        if instance[0] == Sensor.MAG:
            self._tracks.pop(instance[1], None)
        elif instance[1] in self._inertial:
            self._inertial = self.present(Sensor.ACCEL)[0], self.present(Sensor.GYRO)[0]

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        self._recent = [*self._recent[-2:], frame]
        if len(self._recent) > 1:
            # One tick late, so that the gyro's samples reach beyond the compass's.
            self._collect(self._recent[-2])
        self._judge_strength()
        if self.outcome is None and self.time - self._looked >= LOOK_EVERY:
            self._looked = self.time
            for track in self._tracks.values():
                track.update()
            self._advise()
            self._judge()
        if self.outcome is None:
            self._ask()
            self._update_prompt()

    # -- collecting ------------------------------------------------------------------------------------------------

    def _collect(self, frame: TickChannels) -> None:
        known: tuple[Array, BodyMotion | None] | None = None
        for (sensor, instance), channel in frame.items():
            if sensor != Sensor.MAG or instance not in self.present(Sensor.MAG):
                continue
            if known is None or not np.array_equal(known[0], channel.t):
                known = channel.t, self._motion(channel.t)
            motion = known[1]
            if motion is None:
                continue
            if instance not in self._tracks:
                self._tracks[instance] = MagTrack(
                    instance,
                    self.context.earth_field,
                    self.context.in_force(Sensor.MAG, instance),
                    self.context.body_from_sensor(Sensor.MAG, instance),
                    quantum=channel.quantum,
                    relative=self.context.relative,
                )
            self._tracks[instance].add(channel.values, motion)

    def _motion(self, t: Array) -> BodyMotion | None:
        """Motion of the body at the compass times `t`, from the last ticks; None: the inertial samples are missing."""
        accel_t, accel = self._lately((Sensor.ACCEL, self._inertial[0]))
        gyro_t, gyro = self._lately((Sensor.GYRO, self._inertial[1]))
        if len(accel_t) < 2 or len(gyro_t) < 2:
            return None
        middle = t - 0.5 * self._window
        # The reference of a thermal correction is left out: it tilts the vertical by less than the 10 % gate.
        force = self._accel.matrix @ (interpolated(middle, accel_t, accel) - self._accel.offset).T
        turning = self._rotation @ interpolated(middle, gyro_t, gyro).T
        return BodyMotion(rates_during(t, gyro_t, gyro, self._window), force.T, turning.T)

    def _lately(self, instance: Instance) -> tuple[Array, Array]:
        parts = [f[instance] for f in self._recent if instance in f]
        if not parts:
            return np.empty(0), np.empty((0, 3))
        t = np.concatenate([p.t for p in parts])
        values = np.concatenate([p.values for p in parts])
        later = np.diff(t, prepend=-np.inf) > 0.0
        return t[later], values[later]

    def _judge_strength(self) -> None:
        """Report a magnet at a compass early, before minutes of turning that would fail."""
        if self.elapsed < HARD_IRON_AFTER:
            return
        field = self.context.earth_field.norm if self.context.earth_field is not None else 65.0
        for instance, track in list(self._tracks.items()):
            if track.nearest - 1.3 * field > COMPASS_OFFSET_MAX_UT:
                reason = (
                    f"{label(Sensor.MAG, instance)} reads {track.nearest:.0f} uT at least, where the Earth gives "
                    f"{field:.0f} uT: a magnet or magnetised steel is at the sensor"
                )
                self._attendance.present.discard((Sensor.MAG, instance))
                del self._tracks[instance]
                self._fell_out((Sensor.MAG, instance), reason)
                if not self._tracks:
                    self._give_up(reason, "find and remove it, or move the compass away, then start again")

    # -- judging ---------------------------------------------------------------------------------------------------

    def _judge(self) -> None:
        late = self.elapsed >= self.options["patience"]
        promising = self._tracks and all(t.predicted <= 1.5 * self._target for t in self._tracks.values())
        if late or (promising and self.elapsed >= SHORTEST and self.time >= self._next_fit):
            self._refit()
            reached = self._worst() <= self._target
            if reached and self._reached_at is None:
                self._reached_at = self.time
            self._next_fit = self.time + (LOOK_EVERY if reached else max(LOOK_EVERY, (BACKOFF - 1.0) * self.elapsed))
            mountings = self._mountings()
            if reached and (late or self._confirmed(mountings)):
                self._end(mountings, f"the heading of every compass is known to {self._worst():.2f} deg or better")
            elif late:
                self._end_late(mountings)

    def _refit(self) -> None:
        for track in self._tracks.values():
            track.refit()

    def _mountings(self) -> dict[int, OrientationResult | None]:
        """Mounting that explains each compass.

        Without a known place, a mirrored compass looks like a rotated one in a field of opposite dip. All compasses are
        in one field, so those mounted as stated determine its direction.
        """
        found = {i: t.mounting() for i, t in self._tracks.items()}
        if self.context.earth_field is not None:
            return found
        known = [m.sine for m in found.values() if m is not None and m.verdict == MountingVerdict.AS_STATED]
        if not known:
            return found
        sine = float(np.median(known))
        return {
            i: self._tracks[i].mounting(sine) if m is not None and m.verdict != MountingVerdict.AS_STATED else m
            for i, m in found.items()
        }

    def _worst(self) -> float:
        return max((t.heading_sd for t in self._tracks.values()), default=math.inf)

    def _confirmed(self, mountings: dict[int, OrientationResult | None]) -> bool:
        """Whether every mounting is determined, or the extra time is over."""
        clear = all(m is not None and m.verdict != MountingVerdict.AMBIGUOUS for m in mountings.values())
        waited = self._reached_at is not None and self.time - self._reached_at >= CONFIRM_MOUNTING
        if not clear and not waited:
            self._text = "Tilt the vehicle to all sides while turning: the mounting of the compass is not clear yet."
        return clear or waited

    def _end_late(self, mountings: dict[int, OrientationResult | None]) -> None:
        fitted = [t for t in self._tracks.values() if t.heading_sd <= self._target]
        if not fitted:
            self._give_up(*self._missing())
            return
        for track in self._tracks.values():
            if track not in fitted:
                self._warn(f"{label(Sensor.MAG, track.instance)} missed the goal: {self._why(track)}")
        self._end(mountings, f"{len(fitted)} of {len(self._tracks)} compasses reached {self._target:.2f} deg in time")

    def _end(self, mountings: dict[int, OrientationResult | None], because: str) -> None:
        self._dropped_rows()
        fits = [t.result(mountings[i]) for i, t in self._tracks.items() if t.fit is not None]
        if all(fit.status == FitStatus.REFUSED for fit in fits):
            reason = fits[0].message if fits else "no compass gave enough samples"
            self._give_up(f"no compass can be calibrated: {reason}", "repeat away from steel, magnets and currents")
            return
        self._succeed(fits, because)

    def _on_answer(self, value: str) -> None:
        """``finish``: the operator accepts the present result."""
        self._refit()
        mountings = self._mountings()
        worst = self._worst()
        if worst > self._target:
            self._warn(
                f"ended by the operator at a heading uncertainty of {worst:.2f} deg ({self._target:.2f} asked for)"
            )
        self._end(mountings, "the operator ended it")

    def _missing(self) -> tuple[str, str]:
        if not self._tracks:
            return "no compass gave samples with the motion at their times", "check the streams and start again"
        track = max(self._tracks.values(), key=lambda t: t.heading_sd)
        advice = track.coverage.advice(track.noise, track.inclination)
        return f"{label(Sensor.MAG, track.instance)}: {self._why(track)}", advice.text

    def _why(self, track: MagTrack) -> str:
        if track.fit is None:
            return f"{len(track)} usable samples came in ({track.blurred} were blurred by fast turns)"
        if track.fit.status == FitStatus.REFUSED:
            return track.fit.message
        extra = f"; {track.fit.warnings[0]}" if track.fit.warnings else ""
        return f"its heading is known to {track.heading_sd:.2f} deg, not to {self._target:.2f}{extra}"

    # -- telling ---------------------------------------------------------------------------------------------------

    def _advise(self) -> None:
        if not self._tracks or self.time - self._advised < ADVISE_EVERY:
            return
        self._advised = self.time
        track = max(self._tracks.values(), key=lambda t: t.predicted)
        advice = track.coverage.advice(track.noise, track.inclination)
        self._direction = advice.direction
        self._text = advice.text[0].upper() + advice.text[1:] + "."

    def _ask(self) -> None:
        usable = any(t.predicted <= max(USABLE, self._target) for t in self._tracks.values())
        worst = max((self._heading_sd(t) for t in self._tracks.values()), default=math.inf)
        short = f"The heading is known to {worst:.1f} deg, not to {self._target:g} deg." if worst > self._target else ""
        self._show(
            Prompt(
                PromptStep.ROTATE,
                self._text,
                rotate=True,
                direction=self._direction,
                answers=("finish",) if usable else (),
                unfinished=short if usable else "",
            )
        )

    @staticmethod
    def _heading_sd(track: MagTrack) -> float:
        """Uncertainty of the heading of a compass, now or once it is fitted, deg."""
        return min(track.heading_sd, track.predicted) if track.fit is None else track.heading_sd

    def _update_prompt(self) -> None:
        if not self._tracks:
            return
        known = {i: self._heading_sd(t) for i, t in self._tracks.items()}
        worst = max(known.values(), default=math.inf)
        finite = math.isfinite(worst)
        # Information grows with the samples while the vehicle is turned.
        eta = self.elapsed * ((worst / self._target) ** 2 - 1.0) if finite and worst > self._target else None
        model = self.context.earth_field.norm if self.context.earth_field is not None else None
        detail = {
            "heading_sd_deg": {str(i): sd if math.isfinite(sd) else None for i, sd in known.items()},
            "field_ut": {str(i): t.strength if math.isfinite(t.strength) else None for i, t in self._tracks.items()},
            "model_ut": model,
            "coverage_mask": {str(i): t.coverage.mask for i, t in self._tracks.items()},
            "coverage": min((t.coverage.fraction for t in self._tracks.values()), default=0.0),
            "samples": {str(i): len(t) for i, t in self._tracks.items()},
            "warnings": [*self.warnings, *self._strange_fields(model)],
        }
        share = share_of_information(self._target, worst)
        text = f"heading known to {worst:.1f} deg" if finite else "too few directions yet"
        self._report(Progress(share, 100.0, "%", text, eta if eta is None or eta < 600.0 else None, detail))

    def _strange_fields(self, model: float | None) -> list[str]:
        if model is None:
            return []
        return [
            f"{label(Sensor.MAG, i)} reads {t.strength:.0f} uT where the model gives {model:.0f} uT: "
            "a magnet or steel is near, or it is not calibrated yet"
            for i, t in self._tracks.items()
            if math.isfinite(t.strength) and abs(t.strength / model - 1.0) > FIELD_WITHIN
        ]
