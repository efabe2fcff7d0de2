"""Logs of known answers: ``python -m bench.flights --data FOLDER [--only NAME]... [--columns inspect,fits,gap]``.

Every log is given to the commands as a user would give it; what they say is compared with ``flights.toml``. Exit code
1: an answer is wrong.
"""

from __future__ import annotations

import argparse
import json
import lzma
import resource
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

ANSWERS = Path(__file__).with_name("flights.toml")
WRONG_USE = 2
LIMIT_S = 900.0


@dataclass(frozen=True)
class FlightResult:
    """What one command said of one log: `right`, in short words, after so much processor time."""

    right: bool
    said: str
    seconds: float


def ran(*arguments: str) -> tuple[dict[str, Any], float]:
    """The JSON of one command and its processor time, s; an error is a document with the status ``error``."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [str(Path(sys.executable).with_name("mavcal")), *arguments, "--json"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return {"status": "error", "message": f"no answer within {LIMIT_S:.0f} s"}, LIMIT_S
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode == WRONG_USE or not done.stdout.strip():
        said = (done.stderr.strip().splitlines() or ["no answer"])[-1]
        return {"status": "error", "message": said.removeprefix("mavcal: ")}, seconds
    document: dict[str, Any] = json.loads(done.stdout)
    return document, seconds


def inspected(path: Path, answer: Mapping[str, Any]) -> FlightResult:
    """The sensors that ``mavcal inspect`` calls bad, against those that are."""
    document, seconds = ran("inspect", str(path))
    health = document.get("health")
    if health is None:
        right = not answer["bad"] and document.get("status") == "error"
        return FlightResult(right, str(document.get("message", "no health")), seconds)
    bad = {s["name"]: s["verdict"] for s in health["sensors"] if s["verdict"] in ("suspicious", "faulty")}
    missed = sorted(set(answer["bad"]) - set(bad))
    false = sorted(set(bad) - set(answer["bad"]) - set(answer.get("open", ())))
    said = ", ".join(f"{name} {verdict}" for name, verdict in bad.items()) or "no sensor bad"
    said += f"; missed {', '.join(missed)}" if missed else ""
    said += f"; falsely {', '.join(false)}" if false else ""
    return FlightResult(not missed and not false, said, seconds)


def fitted(path: Path, asked: Mapping[str, Any]) -> FlightResult:
    """One fit: its status, whether it proposes something, and its numbers, against the answer."""
    unit = ["--instance", str(asked["instance"])] if "instance" in asked else []
    document, seconds = ran("fit", asked["method"], str(path), *unit)
    found = document["fits"][0] if document.get("fits") else document
    status = str(found["status"])
    wrong = [] if status in asked.get("status", (status,)) else ["status"]
    if "proposed" in asked and bool((found.get("native") or {}).get("proposed")) != asked["proposed"]:
        wrong.append("proposal")
    for name, (expected, tolerance) in asked.get("near", {}).items():
        number = reduce(lambda held, key: held.get(key) if isinstance(held, dict) else None, name.split("."), found)
        if not _near(number, expected, tolerance):
            wrong.append(f"{name.rpartition('.')[2]} {_shown(number)}")
    label = asked["method"] + (f" {asked['instance'] + 1}" if "instance" in asked else "")
    said = f"{label}: {status}" + (f" ({', '.join(wrong)} wrong)" if wrong else "")
    return FlightResult(not wrong, said, seconds)


def diagnosed(path: Path, sim: Path, asked: Mapping[str, Any]) -> FlightResult:
    """The gap against the simulated side: its verdict, every effect that should be named, and no other."""
    document, seconds = ran("gap", "--real", str(path), "--sim", str(sim))
    verdict = str(document.get("verdict", document.get("status")))
    named = {f"{effect['id']} {unit}" for effect in document.get("effects", ()) for unit in effect["instances"]}
    missed = sorted(set(asked["effects"]) - named)
    false = sorted(named - set(asked["effects"]) - set(asked.get("also", ())))
    said = f"{verdict}: {', '.join(sorted(named)) or 'no effect'}"
    said += f"; missed {', '.join(missed)}" if missed else ""
    said += f"; falsely {', '.join(false)}" if false else ""
    return FlightResult(verdict in asked["verdict"] and not missed and not false, said, seconds)


def _near(number: Any, expected: Sequence[float], tolerance: float) -> bool:
    if not isinstance(number, list) or len(number) != len(expected) or any(isinstance(v, list) for v in number):
        return False
    return all(abs(a - b) <= tolerance for a, b in zip(number, expected, strict=True))


def _shown(number: Any) -> str:
    if isinstance(number, list) and not any(isinstance(v, list) for v in number):
        return "(" + ", ".join(f"{v:.3g}" for v in number) + ")"
    return "missing" if number is None else "of another form"


def unpacked(data: Path, name: str, folder: Path) -> Path:
    """The file `name` of `data`, out of its xz where it is packed."""
    source = data / name
    if source.suffix != ".xz":
        return source
    target = folder / f"{source.parent.name}_{source.stem}"
    if not target.exists():
        with lzma.open(source) as packed, target.open("wb") as plain:
            while piece := packed.read(1 << 20):
                plain.write(piece)
    return target


def results(answer: Mapping[str, Any], data: Path, folder: Path, columns: Sequence[str]) -> Iterator[FlightResult]:
    """What the asked commands say of one log."""
    path = unpacked(data, answer["file"], folder)
    if "inspect" in columns:
        yield inspected(path, answer)
    if "fits" in columns:
        yield from (fitted(path, asked) for asked in answer.get("fit", ()))
    if "gap" in columns and "gap" in answer:
        yield diagnosed(path, unpacked(data, answer["gap"]["sim"], folder), answer["gap"])


def main() -> int:
    """Run what is asked for, and print a row as soon as it is there."""
    parser = argparse.ArgumentParser(prog="python -m bench.flights", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="the folder with the recordings")
    parser.add_argument("--only", action="append", default=[], metavar="NAME")
    parser.add_argument("--columns", default="inspect,fits", help="some of inspect,fits,gap")
    asked = parser.parse_args()
    right = whole = 0
    print("| log: what is true | | said | s |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for answer in tomllib.loads(ANSWERS.read_text(encoding="utf-8"))["log"]:
            if asked.only and answer["name"] not in asked.only:
                continue
            for one in results(answer, asked.data, Path(folder), asked.columns.split(",")):
                whole, right = whole + 1, right + one.right
                mark = "right" if one.right else "**wrong**"
                print(f"| {answer['name']}: {answer['answer']} | {mark} | {one.said} | {one.seconds:.1f} |", flush=True)
    print(f"\n{right} of {whole} answers are right")
    return 0 if right == whole else 1


if __name__ == "__main__":
    sys.exit(main())
