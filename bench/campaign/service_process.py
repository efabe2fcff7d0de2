"""``mavcal serve`` as a process of its own, to be killed; and its journal, read from outside while it writes."""

from __future__ import annotations

import json
import select
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

from mavcal.client import Client
from mavcal.service.lifetime import ending_with_us

START_S = 120.0
POLL_S = 0.0001
DATABASE = "mavcal.sqlite3"


class ServiceProcess:
    """A service on a data directory and one link.

    Raises
    ------
    RuntimeError
        If it does not come up, with what it said last.
    """

    def __init__(self, data_dir: Path, connect: str) -> None:
        command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", "0"]
        command += ["--connect", connect, "--data-dir", str(data_dir)]
        data_dir.mkdir(parents=True, exist_ok=True)
        self._open = ExitStack()
        self._log = self._open.enter_context((data_dir / "service.log").open("ab"))
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=self._log,
            cwd=Path(__file__).resolve().parents[2],
            env=ending_with_us(),
        )
        assert self._process.stdout is not None
        readable, _, _ = select.select([self._process.stdout], [], [], START_S)
        line = self._process.stdout.readline() if readable else b""
        if not line:
            self.kill()
            said = (data_dir / "service.log").read_text(errors="replace").strip().splitlines()[-3:]
            raise RuntimeError(f"the service did not come up: {said}")
        self.client = self._open.enter_context(Client(json.loads(line)["url"]))

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def kill(self) -> None:
        """SIGKILL; harmless if repeated."""
        if self.alive:
            self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._open.close()


def journal(data_dir: Path, job_id: str) -> list[str]:
    """The steps of a job's journal, oldest first, through a connection that cannot write."""
    with closing(_read_only(data_dir)) as db:
        return _steps(db, job_id)


def wait_for_step(
    data_dir: Path, job_id: str, reached: Callable[[list[str]], bool], ended: Callable[[], bool], timeout_s: float
) -> bool:
    """Wait until the journal is as `reached` says; False if `ended` came first, or the time is up."""
    deadline = time.monotonic() + timeout_s
    with closing(_read_only(data_dir)) as db:
        while time.monotonic() < deadline:
            for _ in range(200):
                if reached(_steps(db, job_id)):
                    return True
                time.sleep(POLL_S)
            if ended():
                return reached(_steps(db, job_id))
    return False


def _read_only(data_dir: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"file:{data_dir / DATABASE}?mode=ro", uri=True, isolation_level=None, timeout=5.0)


def _steps(db: sqlite3.Connection, job_id: str) -> list[str]:
    return [row[0] for row in db.execute("SELECT step FROM journal WHERE job_id = ? ORDER BY id", (job_id,))]
