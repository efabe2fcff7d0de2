"""Measures the processor time of a start: of the command line's help, of a service until its page and API answer."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.rows import Row, Section
from bench.running import ended, processor_s, service, starting

HELP_S = 0.3
READY_S = 3.0
PAGE_S = 1.0
_GIVE_UP_S = 60.0
RUNS = 5


def run() -> Section:
    """Help of the command line, the best of some runs; the service once."""
    rows = [_help(words) for words in (["--help"], ["fit", "--help"], ["calibrate", "--help"])]
    return Section("Start", (*rows, _page(), _ready()))


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
    met = best <= HELP_S if target else None
    return Row(f"mavcal {' '.join(words)}", target, f"{best:.2f} s of processor time", met)


def _page() -> Row:
    began, port = time.monotonic(), _free_port()
    with TemporaryDirectory() as folder:
        process = starting("udpin:127.0.0.1:0", Path(folder) / "data", port)
        try:
            while not _answers(f"http://127.0.0.1:{port}/") and time.monotonic() - began < _GIVE_UP_S:
                time.sleep(0.02)
            return _row("page", PAGE_S, time.monotonic() - began, processor_s(process.pid))
        finally:
            ended(process)


def _ready() -> Row:
    began = time.monotonic()
    with TemporaryDirectory() as folder, service("udpin:127.0.0.1:0", Path(folder) / "data") as running:
        return _row("interface", READY_S, time.monotonic() - began, running.processor_s())


def _row(what: str, limit: float, took: float, spent: float) -> Row:
    measured = f"{took:.1f} s, {spent:.1f} s of processor time"
    return Row(f"service until its {what} answers", f"<= {limit:.0f} s", measured, min(took, spent) <= limit)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=_GIVE_UP_S) as response:
            return bool(response.status == 200)
    except (urllib.error.URLError, ConnectionError):
        return False
