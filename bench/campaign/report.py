"""What a run hands back: plain data that goes from one process to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bench.campaign.judge import Ending


@dataclass(frozen=True)
class Pinned:
    """One parameter that the vehicle accepted but did not apply."""

    name: str
    effect: float
    """How far its stream is off, in standard deviations of the check."""
    missed: bool
    """The job ended succeeded, with this parameter proved."""
    named: bool
    """The job says by name that it has no effect."""


@dataclass(frozen=True)
class FaultReport:
    """The outcome of a fault run."""

    index: int
    seed: int
    recipe: str
    autopilot: str
    job: str
    ending: Ending
    complaints: tuple[str, ...]
    strikes: Mapping[str, int]
    """How often each kind of fault struck after the first PARAM_SET."""
    doubts: int = 0
    """How often the job was seen in doubt, each with its list compared."""
    resolved: bool = False
    """It was in doubt and came out of it by itself."""
    pinned: tuple[Pinned, ...] = ()
    says: str = ""
    """The job's own last sentence."""
    seconds: float = 0.0
    stops: int = 0
    """Stopping faults in mid-write: each was followed by a doubt and by no PARAM_SET, or the run is a failure."""

    @property
    def reproduce(self) -> str:
        """The command that repeats this run."""
        return f"scripts/campaign faults --seed {self.seed} --run {self.index}"


@dataclass(frozen=True)
class KillReport:
    """The outcome of a SIGKILL run."""

    index: int
    seed: int
    scene: str
    aimed: str
    struck: tuple[str, ...]
    """The last journal step at each kill."""
    ending: Ending
    complaints: tuple[str, ...]
    says: str = ""
    seconds: float = 0.0
    journal: tuple[str, ...] = field(default=())
    part: str = "kills"
    """Whose process was killed: the service's (``kills``) or the command line's (``cli``)."""

    @property
    def reproduce(self) -> str:
        """The command that repeats this run."""
        return f"scripts/campaign {self.part} --seed {self.seed} --run {self.index}"
