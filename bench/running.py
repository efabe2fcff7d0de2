"""A real service in a process of its own, to be measured or killed, and a vehicle that it has found."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mavcal.client import Client
from mavcal.service.lifetime import ending_with_us

_START_S = 120.0
_FOUND_S = 60.0
_STOP_S = 15.0


class RunningService:
    """``mavcal serve`` on one link, with its client.

    Raises
    ------
    RuntimeError
        If it does not come up, with what it said last.
    """

    def __init__(self, connect: str, data_dir: Path) -> None:
        self._process = starting(connect, data_dir)
        self.data_dir, self.pid = data_dir, self._process.pid
        assert self._process.stdout is not None
        readable, _, _ = select.select([self._process.stdout], [], [], _START_S)
        line = self._process.stdout.readline() if readable else b""
        if not line:
            ended(self._process)
            said = _log(data_dir).read_text(errors="replace").strip().splitlines()[-3:]
            raise RuntimeError(f"the service did not come up: {said}")
        self.url = str(json.loads(line)["url"])
        self.client = Client(self.url)

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def kill(self) -> None:
        """SIGKILL; harmless if repeated."""
        self._process.kill()
        self.stop()

    def stop(self) -> None:
        """End it in an orderly way; harmless if repeated."""
        ended(self._process)
        self.client.close()

    def resident_bytes(self) -> int:
        """Memory that the process holds now (VmRSS of Linux)."""
        return resident_bytes(Path(f"/proc/{self.pid}/status").read_text())

    def processor_s(self) -> float:
        """See :func:`processor_s`."""
        return processor_s(self.pid)

    def children(self) -> list[int]:
        """Processes that it has started and that have not ended."""
        tasks = Path(f"/proc/{self.pid}/task").iterdir()
        return [int(pid) for task in tasks for pid in (task / "children").read_text().split()]

    def recorded(self, marker: bytes) -> int:
        """How often these bytes stand in the telemetry logs."""
        return sum(path.read_bytes().count(marker) for path in (self.data_dir / "tlogs").glob("*.tlog"))

    def found(self) -> str:
        """The id of the first vehicle once it is identified. Raises RuntimeError if there is none within a minute."""
        until = time.monotonic() + _FOUND_S
        while time.monotonic() < until:
            vehicles = self.client.list_vehicles()
            if vehicles and not vehicles[0].silent and vehicles[0].uid:
                return vehicles[0].id
            time.sleep(0.02)
        raise RuntimeError(f"the service did not find the simulated vehicle within {_FOUND_S:g} s")


@contextmanager
def service(connect: str, data_dir: Path) -> Iterator[RunningService]:
    """The same until the context ends."""
    running = RunningService(connect, data_dir)
    try:
        yield running
    finally:
        running.stop()


def starting(connect: str, data_dir: Path, port: int = 0) -> subprocess.Popen[bytes]:
    """The process of ``mavcal serve``; once ready it says its address on stdout."""
    command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", str(port)]
    command += ["--connect", connect, "--data-dir", str(data_dir)]
    root = Path(__file__).resolve().parents[1]
    data_dir.mkdir(parents=True, exist_ok=True)
    with _log(data_dir).open("ab") as log:
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, cwd=root, env=ending_with_us())


def ended(process: subprocess.Popen[bytes]) -> None:
    """Terminate it, and wait until it has gone."""
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


def resident_bytes(status: str) -> int:
    """VmRSS of the text of ``/proc/PID/status``, bytes."""
    line = next(line for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) * 1024


def processor_s(pid: int) -> float:
    """Processor time that a process has used so far (Linux: utime and stime in ticks of 10 ms, proc(5))."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def _log(data_dir: Path) -> Path:
    return data_dir / "service.log"
