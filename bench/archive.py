"""``python -m bench.archive [--logs N]``: an archive of small logs fitted again, with one worker and with two.

Measures the cost per log, how it grows with the archive, and what a second worker gains. Every log is read in a child
process with limits, as in the service; the campaign and every item are kept in a data directory.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.page import machine, shown
from bench.rows import Row, Section
from mavcal.service.lifetime import ending_with_us

LOGS = 10_000
SEED = 20261124
SECONDS, RATE = 20.0, 50.0
"""Length of a log, a gyroscope at rest."""
METHOD = "gyro-rest"
GROWS = 1.2
"""Cost per log of the whole archive, of that of a tenth; more than that is no linear growth."""


@dataclass(frozen=True)
class Run:
    """One campaign; seconds by the clock and of processor time, start and end of the command included."""

    logs: int
    workers: int
    wall_s: float
    cpu_s: float

    def less(self, start: Run) -> Run:
        """Without what a campaign of a single log takes."""
        return Run(self.logs - start.logs, self.workers, self.wall_s - start.wall_s, self.cpu_s - start.cpu_s)

    @property
    def each(self) -> str:
        """Per log."""
        wall, cpu = self.wall_s / self.logs * 1e3, self.cpu_s / self.logs * 1e3
        return f"{wall:.1f} ms by the clock, {cpu:.1f} ms of processor time"


def write_logs(folder: Path, count: int, seed: int) -> None:
    """Small logs, all different, in folders of a thousand."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    for n in range(count):
        below = folder / f"{n // 1000:03}"
        below.mkdir(parents=True, exist_ok=True)
        gyro = 0.02 * rng.standard_normal(3) + 0.002 * rng.standard_normal((len(t), 3))
        np.savez(below / f"{n:06}.npz", t=t, gyro=gyro)


def fitted(folder: Path, pattern: str, workers: int, count: int) -> Run:
    """Fit the logs like `pattern`.

    Raises
    ------
    RuntimeError
        If one of them was lost or failed.
    """
    with TemporaryDirectory(prefix="mavcal-bench-") as data:
        words = [sys.executable, "-m", "mavcal", "campaign", "fit", METHOD, str(folder), "--glob", pattern]
        words += ["--executor", f"threads:{workers}", "--data-dir", data, "--json"]
        before, began = os.times(), time.perf_counter()
        done = subprocess.run(words, capture_output=True, check=False, env=ending_with_us())
        wall, after = time.perf_counter() - began, os.times()
        told = json.loads(done.stdout)
    if told.get("counts") != {"done": count}:
        raise RuntimeError(f"of {count} logs: {told.get('counts', told)}")
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return Run(count, workers, wall, spent)


def run(logs: int = LOGS, folder: Path | None = None) -> Section:
    """Measure; the archive is made from a seed."""
    with TemporaryDirectory(prefix="mavcal-bench-", dir=folder) as made:
        place = Path(made)
        write_logs(place, logs, SEED)
        start = fitted(place, "000000.npz", 1, 1)
        tenth = fitted(place, "*0.npz", 1, -(-logs // 10))
        one, two = (fitted(place, "*.npz", workers, logs) for workers in (1, 2))
    small, whole, both = tenth.less(start), one.less(start), two.less(start)
    growth, gain = (whole.cpu_s / whole.logs) / (small.cpu_s / small.logs), whole.wall_s / both.wall_s
    rows = (
        Row("one log, start and end included", "", f"{start.wall_s:.1f} s, {start.cpu_s:.1f} s of processor time"),
        Row(f"{small.logs + 1} logs, 1 worker: each", "", small.each),
        Row(f"{logs} logs, 1 worker: each", "", whole.each),
        Row(f"- processor time of each, of that at {small.logs + 1}", f"<= {GROWS}", f"{growth:.2f}", growth <= GROWS),
        Row(f"{logs} logs, 2 workers: each", "", both.each),
        Row("- gain of the second worker, by the clock", "", f"{gain:.2f}"),
        Row("the whole archive, 1 and 2 workers; none lost", "", f"{one.wall_s:.0f} s and {two.wall_s:.0f} s"),
    )
    notes = (
        f"Each log is {SECONDS:g} s of a gyroscope at rest at {RATE:g} Hz (seed {SEED}), fitted by {METHOD} in a child "
        "process of its own. A worker is a thread that waits for children. The cost of one log leaves out what a "
        "campaign costs by itself. Processor time is that of the command and all that it starts. A log that is lost or "
        "fails is an error of the measurement.",
    )
    return Section("An archive fitted again", rows, notes)


def main() -> int:
    """Measure and print; exit code 1: a target is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.archive", description=__doc__)
    parser.add_argument("--logs", type=int, default=LOGS, help="logs of the archive")
    parser.add_argument("--folder", type=Path, default=None, help="where it is made")
    asked = parser.parse_args()
    before = machine()
    section = run(asked.logs, asked.folder)
    print(f"{shown(section)}\n\nbefore: {before}; after: {machine()}")
    return 0 if section.met else 1


if __name__ == "__main__":
    sys.exit(main())
