"""What a start costs: processor time of the command line's help, and of a service until it answers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.rows import Row, Section
from bench.running import service

HELP_S = 0.3
READY_S = 3.0
RUNS = 5


def run() -> Section:
    """Help of the command line, the best of some runs; the service once."""
    rows = [_help(words) for words in (["--help"], ["fit", "--help"], ["calibrate", "--help"])]
    return Section("Start", (*rows, _ready()))


def _help(words: list[str]) -> Row:
    program = shutil.which("mavcal", path=os.path.dirname(sys.executable)) or "mavcal"
    spent = []
    for _ in range(RUNS):
        before = os.times()
        subprocess.run([program, *words], check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        spent.append(after.children_user + after.children_system - before.children_user - before.children_system)
    best = min(spent)
    target = "" if words[0] == "calibrate" else f"<= {HELP_S} s"
    return Row(
        f"mavcal {' '.join(words)}",
        target,
        f"{best:.2f} s of processor time",
        best <= HELP_S if target else None,
    )


def _ready() -> Row:
    began = time.monotonic()
    with TemporaryDirectory() as folder, service("udpin:127.0.0.1:0", Path(folder) / "data") as running:
        took, spent = time.monotonic() - began, running.processor_s()
    return Row(
        "service until it answers",
        f"<= {READY_S:.0f} s",
        f"{took:.1f} s, {spent:.1f} s of processor time",
        min(took, spent) <= READY_S,
    )
