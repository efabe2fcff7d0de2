"""The loop: fly the simulator, diagnose the real flight against it, set what differs, fly again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from mavcal.calib.airframe.flown import dropped
from mavcal.calib.gap.schema import GapReport, as_json
from mavcal.calib.recording import Recording
from mavcal.service.closing.conversation import Conversation
from mavcal.service.closing.errors import SimulatorError, WrongCommand
from mavcal.service.closing.follower import Follower
from mavcal.service.closing.link import VehicleLink, require_nobody
from mavcal.service.closing.logs import Flown, find_log, logged_bytes, read_log
from mavcal.service.closing.mission import LogMission, Mission, standard_mission
from mavcal.service.closing.pilot import Pilot
from mavcal.service.closing.proof import SimulatorProof
from mavcal.service.closing.rounds import Outcome, RoundResult, measured, outcome_of
from mavcal.service.closing.settings import SimSettings
from mavcal.service.closing.simulator import FRAME, PARAMETERS, Simulator, SimulatorCommand, free_port
from mavcal.service.closing.work import WorkFolder
from mavcal.service.errors import EndpointError
from mavcal.service.link.endpoint import parse_endpoint

PORT = "{port}"
CONNECT = f"tcp:127.0.0.1:{PORT}"
HEARTBEAT_S = 60.0
"""Time for a simulator to start, wall seconds. Chosen, not measured: Gazebo needs some 20."""
_REPORT_EVERY_S = 0.5
_MOST_DROPPED = 0.02
"""Largest share of samples that a simulator's log may lack. Measured with a log that lacked 8 % in a thousand gaps: a
vibration was named that was not there, and the rotor drag's error doubled. At half the speed nothing was lost."""
_SLOWEST = 1.0
_LOG_QUIET_S, _LOG_MOST_S = 0.7, 30.0
"""Time without growth after which a log counts as complete, and the longest wait, wall seconds. Chosen, not measured:
the logger of ArduPilot writes many times a second."""

OnProgress = Callable[[str, float, float | None], None]
"""Called with the present step, its progress (0..1), and the seconds left (None: not known)."""


class Diagnose(Protocol):
    """Diagnoses the real flight against the simulated one; `sim_patch` of its effects has what to set."""

    def __call__(
        self, real: Recording, sim: Recording, *, frame: Mapping[str, Any], folder: Path, on_progress: OnProgress
    ) -> GapReport:
        """`frame` has the keys of the frame file that was flown; further files may be left in `folder`."""
        ...


@dataclass(frozen=True)
class ClosingPlan:
    """The loop to close: the real flight against the simulator of `command`.

    `rounds` counts flights with a remedy, after the first one with the settings of `start`. `connect` is an endpoint in
    which ``{port}`` stands for the free port of a round.
    """

    real: Recording
    real_sha256: str
    command: SimulatorCommand
    work: Path
    here: Path
    start: SimSettings = field(default_factory=SimSettings)
    rounds: int = 3
    connect: str = CONNECT
    speedup: float = 4.0
    mission: Mission | LogMission = field(default_factory=standard_mission)
    heartbeat_s: float = HEARTBEAT_S


@dataclass(frozen=True)
class ClosingResult:
    """The rounds, and why the loop ended."""

    outcome: Outcome
    rounds: tuple[RoundResult, ...]


class Closing:
    """Closes the loop of `plan`. `on_progress` gets round, activity, share and seconds left, `on_round` each result.

    Raises
    ------
    WrongCommand
        If command and endpoint do not fit together.
    OtherClosing
        If the work folder belongs to another loop.
    WorkFolderUnusable
        If it cannot be made.
    """

    def __init__(
        self,
        plan: ClosingPlan,
        diagnose: Diagnose,
        on_progress: Callable[[int, str, float, float | None], None] = lambda *_: None,
        on_round: Callable[[RoundResult], None] = lambda _result: None,
    ) -> None:
        self._plan, self._diagnose, self._on_progress, self._on_round = plan, diagnose, on_progress, on_round
        _check(plan)
        identity = {
            "real_sha256": plan.real_sha256,
            "command": plan.command.text,
            "mission": plan.mission.kind.value,
            "start": plan.start.as_json(),
        }
        self._folder = WorkFolder(plan.work, identity)
        self._speedup = plan.speedup
        self._number = 0
        self._reported_at = 0.0

    def run(self) -> ClosingResult:
        """Every round until nothing material is left, or the rounds are used up.

        Raises
        ------
        SimulatorError
            If the simulator cannot be flown; the rounds before are kept.
        OtherClosing
            If another process closes this loop now.
        WorkFolderUnusable
            If the work folder cannot be written.
        """
        with self._folder.owned():
            return self._run()

    def _run(self) -> ClosingResult:
        results: list[RoundResult] = []
        settings = self._plan.start
        while True:
            self._number = len(results)
            result = self._folder.result(self._number, settings) or self._round(settings)
            results.append(result)
            self._on_round(result)
            outcome = outcome_of(results, self._plan.rounds)
            if outcome is not None:
                self._folder.keep_progress(self._number, outcome.value, 1.0, 0.0)
                return ClosingResult(outcome, tuple(results))
            settings = result.to_set

    def _round(self, settings: SimSettings) -> RoundResult:
        flown = self._folder.flown(self._number, settings)
        if flown is None:
            flown = self._fly_whole(settings)
            self._folder.keep_flown(self._number, settings, flown)
        folder = self._folder.round_folder(self._number)
        sim = read_log(flown.log)
        self._reported_at = 0.0
        report = self._diagnose(self._plan.real, sim, frame=settings.frame, folder=folder, on_progress=self._report)
        result = measured(
            self._number, report, settings, str(flown.log.relative_to(folder)),
            with_frame=self._plan.command.has("frame"), notes=flown.notes,
        )  # fmt: skip
        self._folder.keep(result, as_json(report))
        return result

    def _fly_whole(self, settings: SimSettings) -> Flown:
        """Fly, again at half the speed where the simulator ran too fast for its logger, down to real time."""
        notes: list[str] = []
        log = self._fly(settings, "starting the simulator")
        while (lost := dropped(read_log(log))) > _MOST_DROPPED:
            said = f"{_speed(self._speedup)} its log lacked {100.0 * lost:.0f} % of its samples"
            if not self._plan.command.has("speedup"):
                return Flown(log, (*notes, f"{said}; write {{speedup}} into the command, and it is flown more slowly"))
            if self._speedup <= _SLOWEST:
                return Flown(log, (*notes, f"{said}; take load off the machine, or choose --speedup 1"))
            self._speedup = max(0.5 * self._speedup, _SLOWEST)
            notes.append(f"{said}: flown again {_speed(self._speedup)}")
            log = self._fly(settings, f"starting the simulator {_speed(self._speedup)}, since {said}")
        return Flown(log, tuple(notes))

    def _fly(self, settings: SimSettings, doing: str) -> Path:
        """Start the simulator, fly the mission, end the simulator; the log that it left."""
        plan, mission, folder = self._plan, self._plan.mission, self._folder.begin_round(self._number)
        settings.write(folder / PARAMETERS, folder / FRAME)
        port = free_port()
        endpoint = parse_endpoint(plan.connect.replace(PORT, str(port)))
        arguments = plan.command.arguments(port=port, speedup=self._speedup, here=plan.here)
        self._reported_at = 0.0
        self._report(doing, 0.0, None)
        if PORT not in plan.connect:  # nobody can listen on a port that was free a moment ago
            require_nobody(endpoint)
        with Simulator(arguments, folder) as simulator:
            try:
                with VehicleLink(endpoint) as link:
                    link.connect(plan.heartbeat_s, simulator.check)
                    SimulatorProof(link, simulator.check).require()
                    flight = _FlightClock(mission.seconds, self._report)
                    vehicle = Conversation(link, simulator.check, flight.report)
                    by_link = {} if plan.command.has("params") else settings.parameters
                    if isinstance(mission, LogMission):
                        Follower(vehicle, mission).fly(by_link)
                    else:
                        Pilot(vehicle, mission).fly(by_link)
                    _let_log_end(vehicle, folder)
            except SimulatorError as error:
                raise error.with_output(simulator.last_lines()) from error
            simulator.stop()
            try:
                return find_log(folder)
            except SimulatorError as error:
                raise error.with_output(simulator.last_lines()) from error

    def _report(self, doing: str, share: float, left_s: float | None) -> None:
        now = time.monotonic()
        if now - self._reported_at < _REPORT_EVERY_S:
            return
        self._reported_at = now
        self._folder.keep_progress(self._number, doing, share, left_s)
        self._on_progress(self._number, doing, share, left_s)


def _speed(speedup: float) -> str:
    return f"at {speedup:g} times real time" if speedup > 0.0 else "as fast as it goes"


class _FlightClock:
    """Progress of a flight, and the remaining wall time."""

    def __init__(self, seconds: float, on_progress: OnProgress) -> None:
        self._seconds, self._on_progress = seconds, on_progress
        self._began = time.monotonic()

    def report(self, done_s: float, doing: str) -> None:
        """Report the share of the mission that is flown, and the wall seconds that the rest takes."""
        share = min(done_s / self._seconds, 1.0)
        spent = time.monotonic() - self._began
        self._on_progress(f"flying ({doing})", share, spent * (1.0 - share) / share if share > 0.0 else None)


def _let_log_end(vehicle: Conversation, folder: Path) -> None:
    """Wait until the log no longer grows: faster than real time, a firmware's logger lags by seconds."""
    vehicle.doing = "waiting for the log"
    vehicle.stop_logging()
    size, since, end = -1, time.monotonic(), time.monotonic() + _LOG_MOST_S
    while time.monotonic() < min(since + _LOG_QUIET_S, end):
        vehicle.pump()
        now = logged_bytes(folder)
        if now != size:
            size, since = now, time.monotonic()


def _check(plan: ClosingPlan) -> None:
    if PORT in plan.connect and not plan.command.has("port"):
        raise WrongCommand(
            "the simulator's command has no {port}, so nobody knows where it listens: write {port} where its MAVLink "
            "port belongs, or say where it is by --connect, such as udpin:127.0.0.1:14550"
        )
    if plan.start.frame and not plan.command.has("frame"):
        raise WrongCommand("a frame file is given, and the simulator's command has no {frame}")
    try:
        parse_endpoint(plan.connect.replace(PORT, "5760"))
    except EndpointError as error:
        raise WrongCommand(str(error)) from error
