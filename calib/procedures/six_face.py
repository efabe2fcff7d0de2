"""All twelve numbers of the accelerometers from six faces of a fixture (METHODS S4).

The directions of gravity are assumed known, so cross terms and the rotation of the sensor in the vehicle are determined
too. The price is that a tilt of the fixture has its full effect. Without a fixture the job ``accel`` is better.
"""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.accel.faces import Face
from mavcal.calib.accel.six_face import fit_six_face
from mavcal.calib.firmware.storable import ACCEL
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.option import Option
from mavcal.calib.procedures.base import TickedProcedure, mean_or_none, refusals
from mavcal.calib.procedures.body_frame import in_sensor
from mavcal.calib.procedures.holds import SHORTEST, HeldPose, Hold, pose_of_hold
from mavcal.calib.procedures.motion import StillnessVerdict
from mavcal.calib.procedures.pose_fit import CHANCE
from mavcal.calib.procedures.poses import DOWN, FACES, TEXTS, down_direction, facing, place
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Sensor

SPEC = ProcedureSpec(
    kind="accel-six-face",
    title="Accelerometer offsets and full matrix from six faces of a fixture",
    sensors=(Sensor.ACCEL, Sensor.GYRO),
    still_only=(Sensor.GYRO,),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option(
            "uncertainty", float, 0.01, "standard deviation to reach on every axis of every offset", "m/s2", 5e-4, 0.2
        ),
        Option(
            "fixture_sd", float, 0.1, "how far from square each face may be (one standard deviation)", "deg", 0.0, 5.0
        ),
        Option("patience", float, 180.0, "gives up after this time without a new face", "s", 20.0, 3600.0),
    ),
    needs="the vehicle, propellers off, put down on its six faces, square on a fixture or a block, "
    "in any order, 3 s each",
    ends_on="standard deviation of every offset (0.01 m/s2), the fixture's tilt included, and faces that agree",
    autopilots=ACCEL,
    duration_s=40.0,
)

ROUNDS = 2
"""Rounds of all faces, if they contradict each other, before giving up."""


class AccelSixFaceProcedure(TickedProcedure):
    """Takes a mean at rest on each face, and fits."""

    spec = SPEC

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = float(options["uncertainty"])
        self._faces: dict[Pose, HeldPose] = {}
        self._round = 1
        self._hold: Hold | None = None
        self._here: Pose | None = None
        self._note = ""
        self._last_taken = -math.inf

    def _on_start(self, present: set[Instance]) -> None:
        self._body = self.bodies(Sensor.ACCEL)
        self._show(place(FACES, ""))

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        verdict = self._watch.update(frame)
        direction = down_direction(self._watch, self._body, self.present(Sensor.ACCEL))
        if not verdict.still or direction is None:
            if self._hold is not None and self._hold.seconds > 0.0:
                self._note = "It was moved too early. "
            self._hold = self._here = None
            self._show(place(self._left(), self._note))
        elif verdict.counted:
            self._rest(frame, end - start, direction)
        if self.outcome is None:
            self._update_prompt(verdict)

    def _left(self) -> tuple[Pose, ...]:
        return tuple(face for face in FACES if face not in self._faces)

    def _rest(self, frame: TickChannels, seconds: float, direction: Array) -> None:
        at = facing(direction)
        if not at.square:
            self._hold = None
            self._show(place(self._left(), f"It is not square on any face ({TEXTS[at.face]} is the nearest). "))
            return
        if at.face in self._faces or at.face == self._here:
            self._show(place(self._left(), self._note or "This face is done. "))
            return
        self._hold = self._hold or Hold(direction)
        self._show(
            Prompt(
                PromptStep.PLACE,
                "At rest: leave it alone.",
                at.face,
                self._left(),
                SHORTEST,
                detected=at.face,
                stable=True,
            )
        )
        self._hold.add(frame, seconds)
        # the offset is a mean of six faces, so the sd of each may be larger by the square root of six
        if self._hold.complete(self._target):
            number = len(self._faces) + 1
            self._faces[at.face] = pose_of_hold(self._hold, number, at.face, direction, self.present(Sensor.ACCEL))
            self._hold, self._here, self._note, self._last_taken = None, at.face, "", self.time
            if not self._left():
                self._evaluate()

    def _evaluate(self) -> None:
        fits = self._fits(float(self.options["fixture_sd"]))
        usable = [f for f in fits if f.status != FitStatus.REFUSED]
        if not usable:
            self._give_up(refusals(fits), "check the board's orientation, and that every face stands square")
            return
        reached = max(float(f.sd[:3].max()) for f in usable)
        if reached <= self._target:
            self._end(fits, reached)
        elif all(f.quality["p_value"] is None or f.quality["p_value"] >= CHANCE for f in usable):
            self._give_up(
                f"the offsets are known to {reached:.4f} m/s2, not to {self._target:.4f}: a tilt of "
                f"{self.options['fixture_sd']:g} deg of the fixture allows no more",
                "use a squarer fixture and state its fixture_sd, ask for less, or take the job accel, which needs none",
            )
        elif self._round < ROUNDS:
            self._round += 1
            self._faces.clear()
            self._note = f"The faces contradict each other (offsets known to {reached:.3f} m/s2): take all six again. "
        else:
            self._give_up(
                f"the faces contradict each other: the offsets are known to {reached:.4f} m/s2, not to "
                f"{self._target:.4f}",
                "put it down more squarely or state a larger fixture_sd; check that nothing vibrates or gives way",
            )

    def _fits(self, fixture_sd: float) -> list[FitResult]:
        return [self._fit(i, fixture_sd) for i in self.present(Sensor.ACCEL)]

    def _fit(self, instance: int, fixture_sd: float) -> FitResult:
        body = self._body[instance]
        means = {face: pose.means[instance] for face, pose in self._faces.items() if instance in pose.means}
        faces = [Face(body @ m.mean, body @ m.covariance @ body.T, np.array(DOWN[f]), m.n) for f, m in means.items()]
        temperatures = [m.temperature for m in means.values() if m.temperature is not None]
        fit = fit_six_face(
            faces,
            gravity=self.context.gravity,
            form="forward",
            fixture_sd=fixture_sd,
            instance=instance,
            temperature=mean_or_none(temperatures),
            relative=self.context.relative,
        )
        return in_sensor(fit, body)

    def _end(self, fits: list[FitResult], reached: float) -> None:
        self._dropped_rows()
        if any(f.temperature is None for f in fits if f.status != FitStatus.REFUSED):
            self._warn("no temperature streamed: the offsets cannot be tied to the temperature they were taken at")
        self._succeed(fits, f"every offset is known to {reached:.4f} m/s2 or better")

    def _update_prompt(self, verdict: StillnessVerdict) -> None:
        if self.time - max(self._last_taken, self._began) >= self.options["patience"]:
            cause, remedy = self._missing()
            self._give_up(
                f"no new face within {self.options['patience']:.0f} s ({verdict.why or 'at rest'}); {cause}", remedy
            )
            return
        done = len(self._faces)
        text = f"{done} of 6 faces" if verdict.still else f"{done} of 6 faces; {verdict.why}"
        eta = (SHORTEST + 3.0) * (6 - done)
        detail = {"hold_s": self._hold.seconds if self._hold else 0.0, "round": self._round}
        self._report(Progress(done, 6.0, "faces", text, eta, detail))

    def _missing(self) -> tuple[str, str]:
        left = ", ".join(TEXTS[face] for face in self._left())
        return (
            f"{len(self._faces)} faces were taken and {len(self._left())} are missing",
            f"put the vehicle down square for {SHORTEST + 1.0:.0f} s each: {left}",
        )
