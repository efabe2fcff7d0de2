"""What a run of the crossed campaign hands back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bench.campaign.judge import Ending


@dataclass(frozen=True)
class CrossReport:
    """The outcome of a run."""

    index: int
    seed: int
    network: str
    process: str
    vehicle: str
    autopilot: str
    job: str
    ending: Ending
    complaints: tuple[str, ...]
    struck: Mapping[str, bool]
    """Whether the fault of the network, of the process and of the vehicle really struck."""
    state: str = ""
    says: str = ""
    doubts: int = 0
    resumed: bool = False
    """A second life of the service brought the job to its end."""
    seconds: float = 0.0
    processor_s: float = 0.0
    """Processor time of the run, the simulated vehicle's included."""

    @property
    def reproduce(self) -> str:
        """The command that repeats this run."""
        return f"scripts/campaign crossed --seed {self.seed} --run {self.index}"
