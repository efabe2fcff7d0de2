"""What a run of the crossed campaign does; everything is drawn from a seed, and every cell comes once in each block."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import product
from typing import Any

from mavcal.service.jobs.crashpoints import At

Json = dict[str, Any]


class Network(StrEnum):
    """What the wire does; from a chosen phase on, on both ways."""

    CLEAN = "clean"
    LOSS = "frames lost"
    REORDER = "frames out of order"
    DUPLICATION = "frames doubled"
    CORRUPTION = "bit errors and short datagrams"
    PARTITION = "partition"
    RECONNECT = "TCP connection cut"
    ADDRESS = "address changes"


class Process(StrEnum):
    """What happens to the service and its machine."""

    CALM = "nothing"
    KILL = "SIGKILL of the service"
    POWER = "loss of power"
    WORKER = "SIGKILL of a worker"
    DATABASE = "database gone"
    CLOCK = "wall clock jumps"
    FULL = "full disk"
    SLOW = "fsync of 50 ms"


class VehicleFault(StrEnum):
    """What the vehicle, or another ground station, does."""

    WELL = "nothing"
    REBOOT = "restarts"
    ARM = "arms"
    SILENCE = "falls silent"
    LOST_ECHO = "echo lost"
    LATE_ECHO = "echo late"
    RIVAL = "second ground station"
    CALIBRATION = "calibrates by itself"


class When(StrEnum):
    """In which part of a job a fault is let loose."""

    CAPTURE = "capture"
    WRITE = "write"
    CHECK = "check"


JOBS: dict[str, float] = {"gyro": 0.62, "level": 0.2, "accel": 0.12, "mag": 0.06}
OPTIONS: dict[str, Json] = {
    "gyro": {"uncertainty": 0.03},
    "level": {"uncertainty": 0.1},
    "accel": {"uncertainty": 0.02, "obliques": 3.0},
    "mag": {"uncertainty": 1.0},
}
POINTS: tuple[tuple[At, int], ...] = (
    (At.CAPTURE_STARTED, 1),
    (At.CAPTURE_RUNNING, 40),
    (At.CAPTURE_CLOSED, 1),
    (At.FITTED, 1),
    (At.ACCEPTED, 1),
    (At.SNAPSHOT_KEPT, 1),
    (At.BEFORE_SEND, 6),
    (At.AFTER_ECHO, 6),
    (At.ECHO_KEPT, 6),
    (At.READ_BACK, 1),
    (At.VERIFIED, 1),
    (At.ROLLBACK_BEGUN, 1),
    (At.BEFORE_UNDO, 2),
    (At.AFTER_UNDO, 2),
    (At.CLOSED, 1),
)
"""Where the service dies, and up to the how-many-th time that it comes there; taking back is made to happen."""
TAKING_BACK = frozenset({At.ROLLBACK_BEGUN, At.BEFORE_UNDO, At.AFTER_UNDO})
KINDS_OF_WRITE = (
    "save_job", "add_event", "add_journal", "add_snapshot", "add_plan", "open_segment", "close_segment", "tlog",
)  # fmt: skip
"""Everything that a job writes to the disk."""
SPEED, REORDERED_SPEED = 20.0, 10.0
"""Vehicle seconds per wall second; a frame held back by 0.05 s must not look like a restarted clock."""


@dataclass(frozen=True)
class Cross:
    """One run."""

    index: int
    seed: int
    network: Network
    process: Process
    vehicle: VehicleFault
    autopilot: str
    job: str
    network_when: When
    vehicle_when: When
    crash: tuple[At, int] | None
    """Where a life of the service ends, and at the how-many-th time; None: it does not."""
    disk: Json = field(default_factory=dict)
    """`kind` of write, `nth` from which on, and `lasting` so many writes of that kind."""
    share: float = 0.0
    """Places a fault among the parameters of a write."""
    config: Json = field(default_factory=dict)

    @property
    def speed(self) -> float:
        """Vehicle seconds per wall second."""
        return REORDERED_SPEED if self.network == Network.REORDER else SPEED

    @property
    def taking_back(self) -> bool:
        """Whether a parameter is pinned, so that the write is taken back."""
        return self.crash is not None and self.crash[0] in TAKING_BACK

    @property
    def simulator_seed(self) -> int:
        """Draws the truth of the sensors."""
        return self.seed * 100_000 + self.index


def crosses(count: int, seed: int, first: int = 0) -> tuple[Cross, ...]:
    """`count` runs of a campaign from the `first` on; run `i` of a seed is always the same."""
    return tuple(cross(i, seed) for i in range(first, first + count))


def cross(index: int, seed: int) -> Cross:
    """One run of a campaign."""
    cells = list(product(Network, Process, VehicleFault))
    block, place = divmod(index, len(cells))
    random.Random(f"cells {seed} {block}").shuffle(cells)
    network, process, vehicle = cells[place]
    draw = random.Random(f"crossed {seed} {index}")
    autopilot = draw.choice(("ardupilot", "px4"))
    job = draw.choices(list(JOBS), list(JOBS.values()))[0]
    crash = None
    if process in (Process.KILL, Process.POWER):
        at, most = draw.choice(POINTS)
        crash = at, draw.randint(1, most)
        job = "gyro" if at in TAKING_BACK else job
    return Cross(
        index,
        seed,
        network,
        process,
        vehicle,
        autopilot,
        job,
        _when(draw),
        When.WRITE if vehicle in (VehicleFault.LOST_ECHO, VehicleFault.LATE_ECHO) else _when(draw),
        crash,
        {"kind": draw.choice(KINDS_OF_WRITE), "nth": draw.randint(1, 12), "lasting": draw.randint(1, 6)},
        draw.random(),
        {
            "thermal": False,
            "parameters": {"INS_GYR_CAL": 0} if autopilot == "ardupilot" else {"IMU_GYRO_CAL_EN": 0},
            "boot_s": draw.choice((3.0, 20.0, 90.0)),
        },
    )


def _when(draw: random.Random) -> When:
    return draw.choices(list(When), (0.3, 0.45, 0.25))[0]
