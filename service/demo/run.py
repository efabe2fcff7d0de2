"""The demonstration: one vehicle, four calibrations, and a comparison with the simulator's truth."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from mavcal.calib.firmware.values import shown
from mavcal.calib.fit import FitResult
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.recording import Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.client import ApiProblem, Client, ClientError, Unreachable
from mavcal.client.enums import JobState, ProofVerdict
from mavcal.client.events import ProgressEvent, PromptEvent, StateEvent
from mavcal.client.jobs import JobModel, PlanModel, PromptModel, ResultModel, SegmentModel
from mavcal.client.problems import VehicleArmed, VehicleSilent
from mavcal.service.demo.judge import DemoJudgement, SensorReport, judge
from mavcal.service.demo.screen import DemoScreen, called
from mavcal.service.lifetime import ending_with_us
from mavcal.service.simvehicle import Operator, SimulatedVehicle, SimulatedVehicleError

Json = dict[str, Any]
T = TypeVar("T")

KINDS = ("gyro", "accel", "mag", "thermal")
NAMES = {"gyro": "Gyro", "accel": "Accelerometer", "mag": "Compass", "thermal": "Temperature"}
SPEED = 30.0
"""Vehicle seconds per wall second."""
WRITING_SPEED = 4.0
"""Vehicle seconds per wall second while parameters are written and proved, so that wall-clock delays do not become
hours for the sensors."""
START_C, END_C, SPAN_C = 22.0, 75.0, 48.0
PROOF_C = 68.0
"""Temperature of the warmed vehicle during the proof, degC: inside the calibrated range, and away from its
reference."""
PROVE_S = 240.0
"""How long the vehicle may take for the movements that prove the rest, seconds of its clock."""
SHOWS = 5.0
"""Change from which a parameter must be proved, in standard deviations of the check. The vehicle starts with an older
calibration, and some of its values have hardly changed."""
PATIENCE_S = 60.0 * SPEED
"""How long a job waits for the next movement, seconds of the vehicle: a minute of ours at this speed."""
READY_S = 10.0
"""How long the vehicle may take to be disarmed and heard before a request is given up, wall seconds."""
OPTIONS: Mapping[str, Json] = {
    **{kind: {"patience": PATIENCE_S} for kind in KINDS},
    "thermal": {"patience": PATIENCE_S, "span": SPAN_C, "extend": False},
}
BARE: Mapping[str, Json] = {"ardupilot": {"INS_GYR_CAL": 0}, "px4": {"IMU_GYRO_CAL_EN": 0}}
"""Settings that keep a vehicle from overwriting parameters: ArduPilot calibrates its gyros at every boot, PX4
always."""
ENDED = frozenset(
    {
        JobState.SUCCEEDED,
        JobState.REVERTED,
        JobState.FAILED,
        JobState.CANCELLED,
        JobState.INTERRUPTED,
        JobState.IN_DOUBT,
    }
)


class DemoError(Exception):
    """A calibration of the demonstration did not end as it should."""


@dataclass(frozen=True)
class DemoResult:
    """What the demonstration found; `ok` decides the exit code."""

    ok: bool
    reasons: tuple[str, ...]
    document: Json


def run(autopilot: str, *, seed: int, screen: DemoScreen, keep_open: bool = False, speed: float = SPEED) -> DemoResult:
    """Calibrate a simulated vehicle and judge the result.

    Raises
    ------
    DemoError
        If a job does not end well, with its own reason, or if the service or the vehicle stops answering.
    """
    try:
        return _run(autopilot, seed=seed, screen=screen, keep_open=keep_open, speed=speed)
    except (ClientError, SimulatedVehicleError, OSError) as error:
        raise DemoError(f"{type(error).__name__}: {error}") from error


def _run(autopilot: str, *, seed: int, screen: DemoScreen, keep_open: bool, speed: float) -> DemoResult:
    began = time.monotonic()
    config = {"temperature": START_C, "parameters": BARE.get(autopilot, {})}
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-demo-") as folder,
        SimulatedVehicle(autopilot, seed=seed, speed=speed, config=config) as vehicle,
        _service(vehicle.url, Path(folder)) as url,
        Client(url) as client,
    ):
        name = {"ardupilot": "ArduPilot", "px4": "PX4"}[autopilot]
        screen.line(f"A simulated {name}, its errors drawn from seed {seed}, {speed:g} times real time", bold=True)
        screen.line(f"Live in the panel: {url}")
        screen.line()
        demo = _Demo(vehicle, client, screen, speed, Path(folder) / "tlogs")
        demo.calibrate_all()
        result = demo.result(time.monotonic() - began)
        if keep_open:
            screen.line(f"\nThe panel stays at {url}. Stop it with Ctrl-C.")
            _wait_for_interrupt()
    return result


class _Demo:
    def __init__(
        self, vehicle: SimulatedVehicle, client: Client, screen: DemoScreen, speed: float, tlogs: Path
    ) -> None:
        self._speed = speed
        self._tlogs = tlogs
        self._vehicle = vehicle
        self._client = client
        self._screen = screen
        self._operator = Operator(vehicle, warm_from=START_C, warm_to=END_C)
        self._truth: Json = vehicle.truth()
        self._judged: list[DemoJudgement] = []
        self._jobs: list[JobModel] = []

    def calibrate_all(self) -> None:
        vehicle_id = self._found()
        for kind in KINDS:
            self._operator.rest()
            before = self._parameters()
            job, truth = self._calibrate(vehicle_id, kind)
            fits = [from_json(fit.model_dump(mode="json"), FitResult) for fit in job.results]
            judged = judge(truth, fits, before, self._parameters())
            self._judged.append(judged)
            self._jobs.append(job)
            self._show(job, judged)

    def result(self, seconds: float) -> DemoResult:
        whole = DemoJudgement(tuple(r for j in self._judged for r in j.reports))
        chi2, freedom, p = whole.joint
        reasons: list[str] = []
        small: list[str] = []
        for job in self._jobs:
            verdicts = job.verification.parameters if job.verification else []
            unproved = [v for v in verdicts if v.acts_on_stream and v.verdict != ProofVerdict.PROVED]
            shown_little = [v.name for v in unproved if v.effect is not None and v.effect < SHOWS * (v.sd or 0.0)]
            large = [v.name for v in unproved if v.name not in shown_little]
            small += shown_little
            if large:
                reasons.append(f"{job.kind}: not proved on the stream: {', '.join(large)}")
        if not whole.honest:
            reasons.append(
                f"largest |error|/sd {whole.largest_z:.2f}, p-value {p:.2g}: the stated sd is not true; "
                f"farthest off: {', '.join(whole.farthest)}"
            )
        self._screen.line()
        self._screen.table(("sensor", "true error before", "after", "unit"), _rows(whole.reports))
        self._screen.line()
        self._screen.line(_verdict(reasons, small), bold=True)
        self._screen.line(
            f"The stated uncertainties are {'true' if whole.honest else 'not true'}: among {freedom} parameters the "
            f"largest error is {whole.largest_z:.1f} of its standard deviations (P {p:.2g}). {seconds:.0f} s."
        )
        self._screen.line(
            f"Now you: {called()} serve --connect sim:{self._truth['autopilot']}, then open http://127.0.0.1:8765/"
        )
        document = {
            "ok": not reasons,
            "reasons": reasons,
            "too_small_to_show": small,
            "seed": self._truth["seed"],
            "autopilot": self._truth["autopilot"],
            "seconds": seconds,
            "largest_z": whole.largest_z,
            "chi2": chi2,
            "dof": freedom,
            "p_value": p,
            "sensors": [_report_document(r) for r in whole.reports],
            "jobs": [
                job.model_dump(mode="json", include={"id", "kind", "state", "warnings", "plan", "verification"})
                for job in self._jobs
            ],
        }
        return DemoResult(not reasons, tuple(reasons), to_json(document))

    def _found(self) -> str:
        until = time.monotonic() + 20.0
        while time.monotonic() < until:
            vehicles = self._client.list_vehicles()
            if vehicles and not vehicles[0].silent and vehicles[0].uid:
                return vehicles[0].id
            time.sleep(0.1)
        raise DemoError("the service did not find the simulated vehicle within 20 s")

    def _parameters(self) -> dict[str, float]:
        stored: dict[str, float] = self._vehicle.call("parameters")["stored"]
        return stored

    def _calibrate(self, vehicle_id: str, kind: str) -> tuple[JobModel, Json]:
        """The ended job, and the truth over the time of its samples."""
        self._screen.begin(NAMES[kind])
        job = _when_ready(lambda: self._client.start_job(vehicle_id, kind=kind, options=OPTIONS.get(kind, {})))
        state = self._follow(job.id, until={JobState.REVIEW} | ENDED)
        job = self._client.get_job(job.id)
        if state not in {JobState.REVIEW, JobState.SUCCEEDED} or job.plan is None:
            raise DemoError(_why(job))
        self._show_plan(job.plan)
        qualities = [fit.quality for fit in job.results]
        # Before a reboot restarts the vehicle's time.
        truth = self._vehicle.truth(*sampled(self._tlogs, job.segments, qualities))
        if state == JobState.SUCCEEDED:  # what the vehicle found out by itself is as good: nothing to write
            return job, truth
        self._operator.rest()
        if kind == "thermal":
            self._vehicle.call("temperature", value=PROOF_C)
        self._vehicle.call("speed", value=WRITING_SPEED)
        state = self._written(job, job.plan.sha256)
        self._vehicle.call("speed", value=self._speed)
        job = self._client.get_job(job.id)
        if state != JobState.SUCCEEDED:
            raise DemoError(_why(job))
        return job, truth

    def _written(self, job: JobModel, digest: str) -> JobState:
        """The state in which the job ends; the plan is applied again if the vehicle was not ready yet."""
        until = time.monotonic() + READY_S
        for times in itertools.count(1):
            self._apply(job, digest, f"{job.id}-{times}")
            state = self._follow(job.id, until={JobState.REVIEW} | ENDED, writes=times)
            if state in ENDED or time.monotonic() > until:
                break
        return state

    def _apply(self, job: JobModel, digest: str, key: str) -> None:
        try:
            _when_ready(
                lambda: self._client.apply_plan(
                    job.id, plan_sha256=digest, reboot=True, prove_s=PROVE_S, idempotency_key=key
                )
            )
        except ApiProblem as error:
            raise DemoError(f"{job.kind}: {error}") from error

    def _follow(self, job_id: str, *, until: Set[JobState], writes: int = 0) -> JobState:
        """Move the vehicle as the job asks until it reaches one of these states, after it began so many `writes`."""
        left = writes
        try:
            for message in self._client.follow_job(job_id):
                event = message.data
                if isinstance(event, ProgressEvent):
                    self._screen.progress(event.data.model_dump())
                elif isinstance(event, PromptEvent) and isinstance(event.data, PromptModel) and not left:
                    if writes:
                        self._vehicle.call("speed", value=self._speed)  # a movement takes as long as it takes
                    self._screen.prompt(event.data.text)
                    self._operator.follow(event.data.model_dump(mode="json"))
                elif isinstance(event, StateEvent):
                    left = max(left - (event.data.state == JobState.APPLYING), 0)
                    if not left and event.data.state in until:
                        return event.data.state
        except Unreachable as error:
            raise DemoError(f"the events of job {job_id} ended early: {error}") from error
        raise DemoError(f"the events of job {job_id} ended early")

    def _show_plan(self, plan: PlanModel) -> None:
        for change in plan.changes:
            old = "-" if change.old is None else f"{shown(change.old, 6)}"
            sd = "" if change.sd is None else f" +- {change.sd:.2g}"
            self._screen.detail(f"{change.name:18} {old:>12} -> {shown(change.new, 6)}{sd} {change.unit}")
        for loss in plan.losses:
            self._screen.detail(f"cannot be held: {loss.text} ({loss.cost:.3g} {loss.unit})")
        for warning in plan.warnings:
            self._screen.detail(f"note: {warning}")

    def _show(self, job: JobModel, judged: DemoJudgement) -> None:
        for report in judged.reports:
            cross = f"; cannot be held {report.cross:.2g}" if report.cross else ""
            self._screen.detail(
                f"{report.sensor.value}[{report.instance}] true error {report.before:.4g} -> {report.after:.3g} "
                f"{report.unit}{cross}; largest |error|/sd {abs(report.score.standardised).max(initial=0.0):.2f}"
            )
        self._screen.detail(_outcome_text(job))
        self._screen.end(_ended(job), good=job.state == JobState.SUCCEEDED)


def _when_ready(ask: Callable[[], T]) -> T:
    """The answer, requested again for a while if the vehicle was just armed, or is late on a busy machine."""
    until = time.monotonic() + READY_S
    while True:
        try:
            return ask()
        except (VehicleArmed, VehicleSilent):
            if time.monotonic() > until:
                raise
        time.sleep(0.5)


def _ended(job: JobModel) -> str:
    """Summary of a calibration in a few words."""
    if job.verification is None or job.plan is None:
        return "nothing to write: what is in force is right"
    written = f"{len(job.plan.changes)} parameters written"
    acting = [v for v in job.verification.parameters if v.acts_on_stream]
    if not acting:
        return f"{written}, read back; the stream shows none"
    return f"{written}, {sum(v.verdict == ProofVerdict.PROVED for v in acting)} of {len(acting)} proved on the stream"


def _rows(reports: Sequence[SensorReport]) -> list[tuple[str, str, str, str]]:
    """A row for each sensor; for drift, only the worst sensor of each kind."""
    rows: list[tuple[str, str, str, str]] = []
    drifts: dict[str, SensorReport] = {}
    for report in reports:
        name = {"accel": "accelerometer", "mag": "compass"}.get(report.sensor.value, report.sensor.value)
        if report.drift:
            worst = drifts.get(name)
            drifts[name] = report if worst is None or report.before > worst.before else worst
        else:
            rows.append((f"{name} {report.instance + 1}", f"{report.before:.3g}", f"{report.after:.2g}", report.unit))
    rows += [(f"{name}, over temperature", f"{r.before:.3g}", f"{r.after:.2g}", r.unit) for name, r in drifts.items()]
    return rows


def sampled(tlogs: Path, segments: Iterable[SegmentModel], qualities: Sequence[Json]) -> tuple[float, float]:
    """Start and end of the inertial samples of a job with these fits, vehicle seconds.

    A bias wanders, and on a busy machine minutes of a fast vehicle pass before a capture begins and after it has ended.
    """
    parts = []
    for span in segments:
        with (tlogs / span.path).open("rb") as file:
            file.seek(span.start_byte)
            parts.append(file.read(span.end_byte - span.start_byte))
    inertial = [c for c in read_tlog(b"".join(parts)).channels if c.sensor in {Sensor.ACCEL, Sensor.GYRO} and len(c)]
    first, last = min(float(c.t[0]) for c in inertial), max(float(c.t[-1]) for c in inertial)
    rests = [(q["began"], q["began"] + q["duration"]) for q in qualities if "began" in q]
    if rests and len(rests) == len(qualities):
        first, last = max(first, min(began for began, _ in rests)), min(last, max(ended for _, ended in rests))
    return first, last


def _verdict(reasons: Sequence[str], small: Sequence[str]) -> str:
    if reasons:
        return f"Not good: {'; '.join(reasons)}"
    proved = "Calibrated. Every parameter that shows on the vehicle's stream is proved there"
    if not small:
        return f"{proved}."
    return f"{proved}, except {', '.join(small)}: {'it' if len(small) == 1 else 'they'} changed by too little to show."


def _report_document(report: SensorReport) -> Json:
    document = {k: v for k, v in vars(report).items() if k != "score"}
    return {**document, "z": report.score.standardised, "chi2": report.score.chi2, "names": report.score.names}


def _outcome_text(job: JobModel) -> str:
    """The outcome of a job in words."""
    if job.outcome is None:
        return "no outcome"
    return job.outcome.text if isinstance(job.outcome, ResultModel) else f"{job.outcome.cause} {job.outcome.remedy}"


def _why(job: JobModel) -> str:
    return f"{job.kind}: {job.state}: {_outcome_text(job)}"


@contextmanager
def _service(connect: str, data_dir: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", "0"]
    command += ["--connect", connect, "--data-dir", str(data_dir)]
    log = (data_dir / "service.log").open("wb")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, cwd=data_dir, env=ending_with_us())  # noqa: S603 - ours
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            lines = (data_dir / "service.log").read_text(errors="replace").strip().splitlines()
            raise DemoError(f"the service did not start: {lines[-1] if lines else 'it lines nothing'}")
        yield str(json.loads(line)["url"])
    finally:
        process.terminate()
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        log.close()


def _wait_for_interrupt() -> None:
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        return
