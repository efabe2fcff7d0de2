"""Running a campaign: cases to files, files to worker processes, answers beside their labels."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib.blind.answers import Answer
from mavcal.calib.blind.cases import Case, Tier, make_case

TIMEOUT_S = 300.0
"""Limit for a case of one minute, with room for a busy machine."""


class Worker:
    """One diagnosing process; started again if it dies or hangs."""

    def __init__(self, timeout_s: float = TIMEOUT_S) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._timeout_s = timeout_s

    def ask(self, order: dict[str, Any]) -> dict[str, Any]:
        """The answer to one order; a process that dies or is silent for too long is an error, and replaced."""
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        timer = threading.Timer(self._timeout_s, process.kill)
        timer.start()
        try:
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            timer.cancel()
        if not line:
            self.close()
            said = f"the diagnosis died or took more than {self._timeout_s:.0f} s"
            return {"error": said, "seconds": self._timeout_s}
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "mavcal.service.commands.gap_worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        return self._process

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


@dataclass(frozen=True)
class Plan:
    """What is run: (tier, seed) pairs, whether selection is nested in the folds, and how many at once."""

    cases: Sequence[tuple[Tier, int]]
    nested: bool
    processes: int


def run(plan: Plan, record: Callable[[dict[str, Any]], None]) -> None:
    """Diagnose every case; `record` gets ``{label, report, error, seconds}``, one at a time, in no order."""
    todo: queue.SimpleQueue[tuple[Tier, int]] = queue.SimpleQueue()
    for case in plan.cases:
        todo.put(case)
    lock = threading.Lock()
    broken: list[Exception] = []

    def drive() -> None:
        worker = Worker()
        try:
            with tempfile.TemporaryDirectory(prefix="mavcal-gap-") as folder:
                for tier, seed in _drained(todo):
                    answer = one(worker, make_case(tier, seed), Path(folder), nested=plan.nested)
                    with lock:
                        record(answer)
        except Exception as error:  # noqa: BLE001 - raised again by the caller's thread
            broken.append(error)
        finally:
            worker.close()

    threads = [threading.Thread(target=drive, daemon=True) for _ in range(plan.processes)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if broken:
        raise broken[0]


def _drained(todo: queue.SimpleQueue[tuple[Tier, int]]) -> Iterator[tuple[Tier, int]]:
    while True:
        try:
            yield todo.get_nowait()
        except queue.Empty:
            return


def one(worker: Worker, case: Case, folder: Path, *, nested: bool) -> dict[str, Any]:
    """Write the pair of files, have it diagnosed, and put the answer beside the label."""
    paths = {side: folder / f"{case.id}_{side}.npz" for side in ("real", "sim")}
    for side, columns in (("real", case.real), ("sim", case.sim)):
        np.savez(paths[side], allow_pickle=False, **columns)
    order = {side: str(path) for side, path in paths.items()}
    answer = worker.ask({**order, "without": list(case.without), "nested": nested})
    for path in paths.values():
        path.unlink()
    return {"label": dict(case.label), **answer}


def answers(lines: Iterable[str]) -> list[Answer]:
    """What was recorded, a JSON object a line."""
    found = []
    for line in lines:
        row = json.loads(line)
        found.append(Answer(row["label"], row.get("report") or {}, row.get("error"), float(row["seconds"])))
    return found
