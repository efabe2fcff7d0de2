"""The simulator's process group ends, whatever happens while it is being ended."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from mavcal.service.closing.simulator import OUTPUT, Simulator
from tests.patience import scaled

DEAF = "import signal, time; signal.signal(15, signal.SIG_IGN); print(1, flush=True); time.sleep(99)"


def test_a_second_ctrl_c_ends_it_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = Simulator([sys.executable, "-c", DEAF], tmp_path)
    end = time.monotonic() + scaled(20.0)
    while not (tmp_path / OUTPUT).read_text() and time.monotonic() < end:
        time.sleep(0.01)
    group = simulator._process.pid

    def interrupted(_s: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mavcal.service.closing.simulator.time.sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simulator.stop()
    with pytest.raises(ProcessLookupError):
        os.killpg(group, 0)
