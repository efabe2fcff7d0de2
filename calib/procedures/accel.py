"""Offsets, scales and cross terms of the accelerometers, from poses held by hand.

Nobody holds a drone square: only the length of the specific force is used, ``|C (m - b)| = g`` on the means of poses
(METHODS 3.3). Six faces and three oblique poses equal the number of unknowns, so that only the prior on the cross terms
would be tested. The fourth oblique pose is the first to test the others.
"""

from __future__ import annotations

import math
from statistics import median

from mavcal.calib.firmware.storable import ACCEL
from mavcal.calib.option import Option
from mavcal.calib.posture import tilted
from mavcal.calib.procedures.base import TickedProcedure
from mavcal.calib.procedures.holds import SHORTEST, HeldPose, Hold, pose_of_hold
from mavcal.calib.procedures.motion import HELD, Disturbance, StillnessVerdict
from mavcal.calib.procedures.pose_fit import Assessment, assess
from mavcal.calib.procedures.poses import FACES, TEXTS, angle, any_of, down_direction, recognise, remaining, tilts
from mavcal.calib.procedures.protocol import Pose, Progress, Prompt, PromptStep, Tilt
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.procedures.spec import Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Array, Sensor

SPEC = ProcedureSpec(
    kind="accel",
    title="Accelerometer offsets, scales and cross terms from poses",
    sensors=(Sensor.ACCEL, Sensor.GYRO),
    still_only=(Sensor.GYRO,),
    helpful=(Sensor.TEMPERATURE,),
    options=(
        Option(
            "uncertainty", float, 0.005, "standard deviation to reach on every axis of every offset", "m/s2", 5e-4, 0.1
        ),
        Option("obliques", float, 4.0, "oblique poses to ask for beside the six faces", "", 3.0, 12.0),
        Option("patience", float, 180.0, "gives up after this time without a new pose", "s", 20.0, 3600.0),
    ),
    needs="the vehicle, propellers off, held still on its six faces and in four oblique poses, in "
    "any order, 2-3 s each",
    ends_on="standard deviation of every offset (0.005 m/s2), and poses that agree (residual test, dof 3 or more)",
    autopilots=ACCEL,
    duration_s=60.0,
)

EXTRA = 6
"""Oblique poses requested in addition to the planned ones before giving up."""

RETAKES = 3
"""Poses taken again before giving up."""

SAME_POSE = math.radians(12.0)
"""Angle, rad, to a taken pose below which a pose counts as the same: it adds little information."""

NEXT_POSE = math.radians(15.0)
"""Angle, rad, from the pose just taken above which the next one begins, even without a detected movement."""


class AccelProcedure(TickedProcedure):
    """Recognises poses and stillness from the data, takes a mean of each pose, and fits."""

    spec = SPEC
    limits = HELD

    def __init__(self, options: Options, context: ProcedureContext) -> None:
        super().__init__(options, context)
        self._target = float(options["uncertainty"])
        self._poses: list[HeldPose] = []
        self._counter = 0
        self._wanted = int(options["obliques"])
        self._retakes = 0
        self._hold: Hold | None = None
        self._here: Array | None = None
        self._note = ""
        self._last_taken = 0.0
        self._measured = 0.0
        self._took: list[float] = []
        self._assessment: Assessment | None = None
        self._left_of: tuple[int, tuple[int, ...]] | None = None
        self._still_left: tuple[Pose, ...] = ()
        self._tilts: tuple[Tilt, ...] = ()

    def _on_start(self, present: set[Instance]) -> None:
        self._body = self.bodies(Sensor.ACCEL)
        self._ask(None, stable=False)

    def _on_tick(self, start: float, end: float, frame: TickChannels) -> None:
        self._measured += end - start if frame else 0.0
        verdict = self._watch.update(frame)
        direction = self._direction()
        if verdict.still and direction is None:
            verdict = StillnessVerdict(
                still=False, ticks=0, why="no accelerometer shows gravity", what=Disturbance.SILENT
            )
        if not verdict.still or direction is None:
            self._on_movement(verdict)
        elif self._here is not None and angle(direction, self._here) > NEXT_POSE:
            self._on_movement(verdict)
            self._watch.reset()
        elif verdict.counted and self._here is None:
            self._keep(frame, end - start, direction)
        if self.outcome is None:
            self._update_prompt(verdict, direction)

    def _direction(self) -> Array | None:
        """Direction of down in the body (3,), from the first accelerometer that shows gravity; None: none does."""
        return down_direction(self._watch, self._body, self.present(Sensor.ACCEL))

    def _on_movement(self, verdict: StillnessVerdict) -> None:
        if self._hold is not None and self._hold.seconds > 0.0:
            self._note = f"The pose was disturbed ({verdict.what or 'it crept away'}): take it again. "
        self._hold = None
        self._here = None

    def _keep(self, frame: TickChannels, seconds: float, direction: Array) -> None:
        if self._is_taken(direction):
            self._note = "This pose is done. "
            return
        self._hold = self._hold or Hold(direction)
        if self._hold.crept(direction):
            self._on_movement(StillnessVerdict(still=False, ticks=0, why="", what=Disturbance.NONE))
            self._watch.reset()
            return
        self._hold.add(frame, seconds)
        if self._hold.complete(0.8 * self._target):
            self._take_pose(self._hold, direction)

    def _is_taken(self, direction: Array) -> bool:
        return self._here is not None or any(angle(direction, p.direction) < SAME_POSE for p in self._poses)

    def _take_pose(self, hold: Hold, direction: Array) -> None:
        self._counter += 1
        self._poses.append(
            pose_of_hold(hold, self._counter, recognise(direction), direction, self.present(Sensor.ACCEL))
        )
        self._hold, self._here, self._note = None, direction, ""
        self._last_taken = self.time
        self._took.append(self._measured)
        self._measured = 0.0
        if not self._left():
            self._evaluate()

    def _evaluate(self) -> None:
        """All requested poses are taken: finish, ask for a further one, take one again, or give up."""
        assessment = assess(self._poses, self.present(Sensor.ACCEL), self.context.gravity, self._target)
        self._assessment = assessment
        if assessment.passed:
            self._end(assessment)
        elif assessment.culprit is not None:
            self._repeat_pose(assessment.culprit, assessment)
        elif self._wanted < int(self.options["obliques"]) + EXTRA:
            self._wanted += 1
            self._note = f"{assessment.short}: a further pose is needed. "
        else:
            self._give_up(
                f"{len(self._poses)} poses do not reach the goal: {assessment.short}",
                "check that nothing vibrates or moves during the holds and that the flight controller is fixed firmly, "
                "then start again, or ask for less",
            )

    def _repeat_pose(self, culprit: HeldPose, assessment: Assessment) -> None:
        self._retakes += 1
        name = f"pose {culprit.number} ({TEXTS[culprit.pose]})"
        if self._retakes > RETAKES:
            self._give_up(
                f"the poses contradict each other: {name} disagrees with the others ({assessment.short})",
                "hold every pose stiller, on a support if possible; check that the flight controller is fixed firmly",
            )
            return
        self._poses.remove(culprit)
        self._note = f"{name[0].upper()}{name[1:]} disagrees with the others: take it again. "
        if angle(self._here if self._here is not None else culprit.direction, culprit.direction) < SAME_POSE:
            self._here = None
        if not self._left():
            self._evaluate()

    def _end(self, assessment: Assessment) -> None:
        self._dropped_rows()
        if any(pose.means[i].temperature is None for pose in self._poses for i in pose.means):
            self._warn("no temperature streamed: the offsets cannot be tied to the temperature they were taken at")
        self._succeed(assessment.fits, assessment.short)

    def _left(self) -> tuple[Pose, ...]:
        key = (self._wanted, tuple(p.number for p in self._poses))
        if key != self._left_of:
            self._left_of = key
            directions = [p.direction for p in self._poses]
            self._still_left = remaining(directions, self._wanted)
            self._tilts = tilts(directions, self._wanted)
        return self._still_left

    def _ask(self, direction: Array | None, *, stable: bool) -> None:
        left = self._left()
        detected = recognise(direction) if direction is not None and stable else None
        towards = None
        taken = stable and self._hold is None and direction is not None and self._is_taken(direction)
        faces = [p for p in left if p in FACES]
        if stable and self._hold is not None:
            pose = "still"
            if detected is not None and direction is not None:
                pose = tilted(direction.tolist()) if detected == Pose.OBLIQUE else TEXTS[detected]
            text = f"{self._note}Hold it {pose}."
        elif faces:
            text = f"{self._note}Hold the vehicle still {any_of(faces)}."
        else:
            towards = next((tilt.direction for tilt in self._tilts if not tilt.taken), None)
            text = f"{self._note}Hold the vehicle still, {tilted(towards) if towards else 'tilted'}."
        self._show(
            Prompt(
                PromptStep.POSE,
                text,
                remaining=left,
                pose=None if faces or not left else Pose.OBLIQUE,
                hold_s=SHORTEST + 1.0,
                direction=towards,
                detected=detected,
                stable=stable,
                taken=taken,
                tilts=self._tilts,
            )
        )

    def _update_prompt(self, verdict: StillnessVerdict, direction: Array | None) -> None:
        self._ask(direction, stable=verdict.counted)
        if self.time - max(self._last_taken, self._began) >= self.options["patience"]:
            cause, remedy = self._missing()
            moving = verdict.why or "the vehicle lies in a pose that is taken already"
            self._give_up(f"no new pose within {self.options['patience']:.0f} s ({moving}); {cause}", remedy)
            return
        done, total = len(self._poses), len(self._poses) + len(self._left())
        per_pose = median(self._took) if self._took else SHORTEST + 3.0  # of measuring alone: no pause is in it
        detail = {
            "hold_s": self._hold.seconds if self._hold else 0.0,
            "offset_sd": self._assessment.offset_sd if self._assessment else None,
            "residual_rms": self._assessment.residual_rms if self._assessment else None,
            "warnings": self.warnings[:],
        }
        text = f"{done} of {total} poses" if verdict.still else f"{done} of {total} poses; {verdict.why}"
        self._report(Progress(done, total, "poses", text, per_pose * (total - done), detail))

    def _missing(self) -> tuple[str, str]:
        left = self._left()
        if not left:
            short = self._assessment.short if self._assessment else "not judged yet"
            return short, "hold further oblique poses"
        names = ", ".join(TEXTS[p] for p in left)
        return (
            f"{len(self._poses)} poses were taken and {len(left)} are missing",
            f"hold the vehicle still for {SHORTEST + 1.0:.0f} s each: {names}",
        )
