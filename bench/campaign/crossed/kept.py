"""Finished runs of the crossed campaign in a file, so that it can be made in parts, over days, and resumed."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from bench.campaign.crossed.report import CrossReport
from mavcal.calib.converter import make_converter, read

_CONVERTER = make_converter()


@dataclass(frozen=True)
class Kept:
    """One finished run: a line of the file."""

    commit: str
    """The commit of the working tree, with ``+`` where something in it was changed; empty outside of git."""
    store: str
    report: CrossReport


def keep(path: Path, kept: Kept) -> None:
    """Append one run, on a line of its own even if the last one was cut short."""
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" + json.dumps(_CONVERTER.unstructure(kept)) + "\n")


def kept_runs(path: Path, seed: int, store: str) -> tuple[Kept, ...]:
    """The runs of that seed and store that the file holds, by number; none if it does not exist.

    A line that a kill cut short is passed over: its run is made again.
    """
    if not path.exists():
        return ()
    found: dict[int, Kept] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            data = json.loads(line)
        except json.JSONDecodeError:
            continue
        kept = read(_CONVERTER, data, Kept)
        if kept.report.seed == seed and kept.store == store:
            found[kept.report.index] = kept
    return tuple(found[index] for index in sorted(found))


def commit_of(folder: Path) -> str:
    """The commit that is checked out there, with ``+`` where files differ from it; empty outside of git."""
    try:
        return subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--exclude=*"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
