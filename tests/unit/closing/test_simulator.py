"""The simulator: its command with placeholders, and a process group that ends, whatever happens meanwhile."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

from mavcal.service.closing.errors import WrongCommand
from mavcal.service.closing.simulator import OUTPUT, Simulator, SimulatorCommand
from tests.patience import scaled


def filled(text: str, here: Path = Path("/home/me")) -> list[str]:
    return SimulatorCommand(text).arguments(port=5760, speedup=4.0, here=here)


def test_placeholders_become_files_of_the_round_port_and_speed() -> None:
    given = (
        "arducopter --model x:{frame} --defaults {here}/my.parm,{params} --speedup {speedup} --base-port {port} {log}"
    )
    assert filled(given) == [
        "arducopter", "--model", "x:frame.json", "--defaults", "/home/me/my.parm,sim.parm", "--speedup", "4",
        "--base-port", "5760", "log.bin",
    ]  # fmt: skip


def test_quotes_hold_words_together_and_doubled_braces_are_braces() -> None:
    assert filled("sh -c 'exec sim {port} --json {{}}'") == ["sh", "-c", "exec sim 5760 --json {}"]


def test_a_program_by_a_relative_path_is_the_one_from_here(tmp_path: Path) -> None:
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "sim").write_text("")
    assert filled("build/sim {port}", tmp_path)[0] == str(tmp_path / "build" / "sim")
    assert filled("bin/other {port}", tmp_path)[0] == "bin/other"


def test_it_knows_which_placeholders_are_used() -> None:
    command = SimulatorCommand("sim x:{frame},a --port={port}")
    assert [command.has(name) for name in ("frame", "port", "params")] == [True, True, False]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        ("sim 'x", "quotes"),
        ("sim {", "braces"),
        ("sim {model} {port}", r"has \{model\}; known are \{params\}"),
        ("sim {} {port}", r"has \{\}"),
    ],
)
def test_what_cannot_be_meant_is_refused(text: str, said: str) -> None:
    with pytest.raises(WrongCommand, match=said):
        SimulatorCommand(text)


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
