"""Offset, full matrix and mounting of the compasses from six rings about the vertical (METHODS S3).

Only the centres of the rings are used, so averaging within the compass does not blur the result. The price is that
every tilt of a face has its full effect, and that the method fails near the magnetic equator.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from mavcal.calib.earth import EarthField
from mavcal.calib.firmware.storable import MAG
from mavcal.calib.fit import FitBuilder, FitResult, FitStatus
from mavcal.calib.mag.free_rotation import angle_between, mirror_words
from mavcal.calib.mag.orientation import ASKEW, RIGHT_ANGLES, FittedRotation, MountingVerdict
from mavcal.calib.mag.result import FIELD_TOLERANCE, rotation_covariance
from mavcal.calib.mag.rings import fit_rings
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, refusals
from mavcal.calib.procedures.body_frame import in_body, in_sensor
from mavcal.calib.procedures.mag_track import mounting_quality
from mavcal.calib.procedures.motion import StillnessVerdict as Stillness
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.pose_fit import CHANCE
from mavcal.calib.procedures.poses import DOWN, FACES, TEXTS, Facing, down_direction, facing, place
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels, label
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.procedures.turning import Spin, SpinWatch
from mavcal.calib.recording import Array, Channel, Sensor

SPEC = ProcedureSpec(
    kind="mag-rings",
    title="Compass hard and soft iron and mounting from six turns about the vertical",
    sensors=(Sensor.MAG, Sensor.GYRO, Sensor.ACCEL),
    aiding=(Sensor.GYRO, Sensor.ACCEL),
    helpful=(),
    options=(
        Option(
            "uncertainty",
            float,
            0.5,
            "standard deviation of the heading to reach with every compass",
            "deg",
            0.05,
            10.0,
        ),
        Option(
            "fixture_sd", float, 0.2, "how far from square each face may be (one standard deviation)", "deg", 0.0, 5.0
        ),
        Option("patience", float, 240.0, "gives up after this time without a new ring", "s", 20.0, 3600.0),
    ),
    needs="the vehicle, propellers off, stood square on each of its six faces and turned once around "
    "there, away from steel and magnets",
    ends_on="standard deviation of the heading of every compass (0.5 deg), the tilt of faces included; rings agree",
    autopilots=MAG,
    duration_s=90.0,
)
FASTEST = math.radians(120.0)
"""Largest rate, rad/s, at which the samples of a 10 Hz compass are at most nine degrees apart."""
_BEGUN = math.radians(10.0)  # turned by less, nothing is lost
ROUNDS = 2
"""Rounds of all six rings before giving up."""
FEWEST = 40
"""Least samples of a ring: nine degrees apart."""
ONCE_AROUND = 2.0 * math.pi


class RingTrack:
    """Collects the compasses' samples of one turn."""

    def __init__(self, face: Pose) -> None:
        self.face = face
        self.down = np.array(DOWN[face])
        self.angle = 0.0
        """Turned so far, rad, signed."""
        self._pool = Pool((Sensor.MAG,))

    def add(self, frame: TickChannels, spin: Spin) -> None:
        """Take a tick of a clean turn about the vertical."""
        self._pool.add(frame)
        self.angle += spin.about(self.down) * spin.seconds

    def channel(self, instance: int) -> Channel | None:
        """Samples of one compass; None: it has none."""
        return self._pool.get((Sensor.MAG, instance))

    def complete(self, instances: tuple[int, ...]) -> bool:
        """Whether the turn is complete, with enough samples of every compass."""
        counts = [len(channel) if (channel := self.channel(i)) is not None else 0 for i in instances]
        return abs(self.angle) >= ONCE_AROUND and min(counts, default=0) >= FEWEST


def mounting_in(rotation: Array, covariance: Array) -> dict[str, Any]:
    """The mounting for `rotation`, in the form of ``quality["orientation"]`` of a compass.

    `rotation` (3, 3) turns the body frame of the stated mounting into the body frame; `covariance` (3, 3), rad^2, is
    that of small rotations of the body. A rotation within 5 degrees of a right-angle one is taken as that one.
    """
    fitted = FittedRotation(rotation, covariance)
    askew, nearest = min((angle_between(m.matrix, rotation), k) for k, m in enumerate(RIGHT_ANGLES))
    best = RIGHT_ANGLES[nearest]
    verdict, message = MountingVerdict.AS_STATED, "mounted as stated"
    if askew > ASKEW:
        verdict = MountingVerdict.BY_ANGLES
        message = (
            f"mounted turned by {fitted.euler}, {math.degrees(askew):.0f} deg from the nearest right-angle mounting "
            f"({best.name})"
        )
    elif nearest:
        verdict, message = MountingVerdict.ROTATED, f"mounted turned by {best.name} against what is stated"
    return mounting_quality(verdict, best, fitted, message)


class MagRingsProcedure(TickedProcedure):
    """Takes one ring on each face, and fits."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = float(options["uncertainty"])
        self._rings: list[RingTrack] = []
        self._done: set[Pose] = set()
        self._round = 1
        self._ring: RingTrack | None = None
        self._asked: Pose | None = None
        self._note = ""
        self._last_taken = -math.inf

    def _on_start(self, present: set[Instance]) -> None:
        self._level = self.bodies(Sensor.ACCEL)
        self._body = self.bodies(Sensor.MAG)
        self._spins = SpinWatch(self.bodies(Sensor.GYRO))
        if self.context.earth_field is None:
            self._warn("the place is not known: the field strength cannot be judged, and the common scale is not set")
        self._show(self._place_prompt())

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        spin = self._spins.update(frame, self.present(Sensor.GYRO), end - start, resting=verdict.counted)
        direction = down_direction(self._watch, self._level, self.present(Sensor.ACCEL))
        if spin is not None and direction is not None:
            self._follow(frame, verdict, spin, facing(direction))
        if self.outcome is None:
            self._update_prompt(verdict)

    def _follow(self, frame: TickChannels, verdict: Stillness, spin: Spin, at: Facing) -> None:
        if self._asked is not None and (not at.square or at.face != self._asked):
            if self._ring is not None and abs(self._ring.angle) > _BEGUN:
                self._note = "It was tilted before the turn was complete: start this ring again. "
            self._ring = self._asked = None
        axis = np.array(DOWN[at.face])
        if at.square and at.face not in self._done:
            if abs(spin.about(axis)) > FASTEST:
                self._ring, self._note = None, "That was too fast: start this ring again, slowly. "
            elif self._spins.rested and spin.steady_about(axis):
                self._turned(frame, spin, at)
                return
            if verdict.counted or self._asked is not None:
                self._asked = at.face
                self._show(self._turn_prompt(at, moving=False))
                return
        self._show(self._place_prompt())

    def _left(self) -> tuple[Pose, ...]:
        return tuple(face for face in FACES if face not in self._done)

    def _place_prompt(self) -> Prompt:
        return place(self._left(), self._note, suffix=" where it can be turned about the vertical")

    def _turn_prompt(self, at: Facing, *, moving: bool) -> Prompt:
        text = (
            "Go on turning, once around." if moving else "Turn it slowly about the vertical, once around, as it stands."
        )
        x, y, z = DOWN[at.face]
        return Prompt(
            PromptStep.TURN, self._note + text, at.face, self._left(), detected=at.face, stable=moving, axis=(x, y, z)
        )

    def _turned(self, frame: TickChannels, spin: Spin, at: Facing) -> None:
        if self._ring is None:
            self._ring, self._asked = RingTrack(at.face), at.face
        self._note = ""
        self._ring.add(frame, spin)
        self._show(self._turn_prompt(at, moving=True))
        if self._ring.complete(self.present(Sensor.MAG)):
            self._rings.append(self._ring)
            self._done.add(self._ring.face)
            self._ring, self._asked, self._last_taken = None, None, self.time
            if self._left():
                self._show(self._place_prompt())
            else:
                self._evaluate()

    # -- judging ---------------------------------------------------------------------------------------------------

    def _evaluate(self) -> None:
        fits = [self._fit(i, float(self.options["fixture_sd"])) for i in self.present(Sensor.MAG)]
        usable = [f for f in fits if f.status == FitStatus.OK]
        if not usable:
            partial = next((f.message for f in fits if f.status == FitStatus.PARTIAL), refusals(fits))
            self._give_up(
                f"no compass can be calibrated by rings: {partial}", "take the job mag, which tilts to all sides"
            )
            return
        reached = max(float(f.quality["heading_sd_deg"]) for f in usable)
        agree = all(f.quality["p_value"] is None or f.quality["p_value"] >= CHANCE for f in usable)
        noise = max(float(self._fit(f.instance, 0.0).quality["heading_sd_deg"]) for f in usable)
        if reached <= self._target:
            self._end(fits, reached)
        elif agree and noise <= self._target:
            self._give_up(
                f"the heading is known to {reached:.2f} deg, not to {self._target:.2f}: a tilt of "
                f"{self.options['fixture_sd']:g} deg of the faces allows no more",
                "use a squarer fixture and state its fixture_sd, ask for less, or take the job mag, which needs none",
            )
        elif self._round < ROUNDS:
            self._begin_again(reached, agree=agree)
        else:
            why = "the rings are too noisy" if agree else "the rings contradict each other"
            self._give_up(
                f"{why}: the heading is known to {reached:.2f} deg, not to {self._target:.2f}",
                "repeat away from steel, magnets and currents, on a block that stands square",
            )

    def _begin_again(self, reached: float, *, agree: bool) -> None:
        self._round += 1
        self._done.clear()
        if not agree:
            self._rings.clear()
        why = "The heading is not known well enough" if agree else "The rings contradict each other"
        self._note = f"{why} ({reached:.1f} deg): take all six again. "

    def _fit(self, instance: int, fixture_sd: float) -> FitResult:
        body = self._body[instance]
        given = [(r, r.channel(instance)) for r in self._rings]
        rings = [(r.down, in_body(channel, body)) for r, channel in given if channel is not None]
        fit = fit_rings(
            [channel.values for _, channel in rings],
            [down for down, _ in rings],
            fixture_sd=fixture_sd,
            instance=instance,
            quantum=max((channel.quantum for _, channel in rings), default=0.0),
            field=self.context.earth_field,
            relative=self.context.relative,
        )
        if fit.status != FitStatus.OK:
            return fit
        return _mounted(fit, instance, self.context.earth_field, body)

    def _end(self, fits: list[FitResult], reached: float) -> None:
        self._dropped_rows()
        for fit in fits:
            ratio = fit.quality.get("field_ratio")
            if ratio is not None and abs(ratio - 1.0) > FIELD_TOLERANCE:
                about = label(Sensor.MAG, fit.instance)
                self._warn(f"{about} reads {ratio:.2f} times the modelled field: a magnet or steel is near")
        in_raw = [in_sensor(f, self._body[f.instance]) for f in fits]
        self._succeed(in_raw, f"the heading of every compass is known to {reached:.2f} deg or better")

    # -- telling ---------------------------------------------------------------------------------------------------

    def _update_prompt(self, verdict: Stillness) -> None:
        if self.time - max(self._last_taken, self._began) >= self.options["patience"]:
            cause, remedy = self._missing()
            self._give_up(f"no new ring within {self.options['patience']:.0f} s; {cause}", remedy)
            return
        done = len(self._done)
        part = min(abs(self._ring.angle) / ONCE_AROUND, 1.0) if self._ring is not None else 0.0
        text = f"{done} of 6 rings"
        if part:
            text += f"; {360.0 * part:.0f} deg of this one"
        per_ring = (self.time - self._began) / (done + part) if done + part > 0.5 else SPEC.duration_s / 6.0
        detail: dict[str, Any] = {
            "angle_deg": 360.0 * part,
            "face": None if self._ring is None else self._ring.face.value,
            "round": self._round,
            "warnings": self.warnings[:],
        }
        self._report(Progress(done + part, 6.0, "rings", text, per_ring * (6.0 - done - part), detail))

    def _missing(self) -> tuple[str, str]:
        names = ", ".join(TEXTS[face] for face in self._left())
        return (
            f"{len(self._done)} rings were taken and {len(self._left())} are missing",
            f"stand the vehicle square and turn it once around: {names}",
        )


def _mounted(fit: FitResult, instance: int, field: EarthField | None, stated: Array) -> FitResult:
    """The fit in the body frame with the mounting from its rotation; refused if the axes are mirrored.

    The centres of the rings lie in the direction of the vertical field, or all opposite to it if an odd number of axes
    is reversed. Only the `field` of the place tells which. `stated` (3, 3) is the stated mounting.
    """
    rotation = fit.model.rotation
    upward = np.linalg.det(np.array(fit.native["columns"])) < 0.0
    if field is not None and upward != (field.inclination < 0.0):
        words = mirror_words(stated.T @ -rotation @ stated)
        made = FitBuilder(fit.method, Sensor.MAG, instance, fit.unit, fit.n_samples)
        message = f"{words}, which no mounting does: the driver or the sensor is at fault"
        remedy = "power-cycle the vehicle and calibrate again; replace the compass if it stays"
        quality = {**fit.quality, "orientation": {"verdict": MountingVerdict.MIRRORED.value, "message": message}}
        return made.refused(message, movement=remedy, quality=quality)
    mounting = mounting_in(rotation, rotation_covariance(fit.model, fit.covariance))
    warnings = fit.warnings
    if mounting["verdict"] != MountingVerdict.AS_STATED:
        warnings += (str(mounting["message"]),)
    return dataclasses.replace(fit, quality={**fit.quality, "orientation": mounting}, warnings=warnings)
