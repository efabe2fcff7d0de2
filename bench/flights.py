"""Logs of known answers: ``python -m bench.flights --data FOLDER [--only NAME]... [--columns inspect,fits,gap]``.

Every log is given to the commands as a user would give it; what they say is compared with ``flights.toml``. Results are
kept in ``flights.json`` beside it, a log and a column at a time, so that columns can be filled on different days. With
``--write`` the table goes to ``docs/flights.md``, between the marks that stand there.
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
from dataclasses import asdict, dataclass
from functools import reduce
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ANSWERS = HERE / "flights.toml"
RESULTS = HERE / "flights.json"
PAGE = HERE.parent / "docs" / "flights.md"
BEGIN, END = "<!-- measured by bench.flights -->", "<!-- end of what was measured -->"
COLUMNS = ("inspect", "fits", "gap")
NOTHING, WRONG_USE = "-", 2
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


def results(answer: Mapping[str, Any], data: Path, folder: Path, columns: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """The asked columns of one log, each as a list of results."""
    path = unpacked(data, answer["file"], folder)
    if "inspect" in columns:
        yield "inspect", [asdict(inspected(path, answer))]
    if "fits" in columns:
        yield "fits", [asdict(fitted(path, asked)) for asked in answer.get("fit", ())]
    if "gap" in columns and "gap" in answer:
        sim = unpacked(data, answer["gap"]["sim"], folder)
        yield "gap", [asdict(diagnosed(path, sim, answer["gap"]))]


def table(answers: Sequence[Mapping[str, Any]], held: Mapping[str, Any]) -> Iterator[str]:
    """The page's table, and how many answers are right."""
    yield "| log: what is true | `inspect` | fits | `gap` |"
    yield "|---|---|---|---|"
    right, whole = dict.fromkeys(COLUMNS, 0), dict.fromkeys(COLUMNS, 0)
    for answer in answers:
        own = held.get(answer["name"], {})
        cells = []
        for column in COLUMNS:
            found = own.get(column)
            if found is None:
                cells.append(NOTHING if column != "gap" or "gap" not in answer else "not run")
                continue
            right[column] += sum(one["right"] for one in found)
            whole[column] += len(found)
            cells.append(
                "<br>".join(
                    f"{'right' if one['right'] else '**wrong**'}: {one['said']} ({one['seconds']:.1f} s)"
                    for one in found
                )
            )
        yield f"| {answer['name']}: {answer['answer']} | {' | '.join(cells)} |"
    yield "| right | " + " | ".join(f"{right[c]} of {whole[c]}" for c in COLUMNS) + " |"


def _cell(one: Mapping[str, Any]) -> str:
    return f"{'right' if one['right'] else '**wrong**'}: {one['said']} ({one['seconds']:.1f} s)"


def main() -> None:
    """Run what is asked for, keep it, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.flights", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="the folder with the recordings")
    parser.add_argument("--only", action="append", default=[], metavar="NAME")
    parser.add_argument("--columns", default="inspect,fits", help=f"some of {','.join(COLUMNS)}")
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE.name}")
    asked = parser.parse_args()
    answers = tomllib.loads(ANSWERS.read_text(encoding="utf-8"))["log"]
    held = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        for answer in answers:
            if asked.only and answer["name"] not in asked.only:
                continue
            for column, found in results(answer, asked.data, Path(folder), asked.columns.split(",")):
                held.setdefault(answer["name"], {})[column] = found
                RESULTS.write_text(json.dumps(held, indent=1, sort_keys=True) + "\n", encoding="utf-8")
                for one in found:
                    print(f"{answer['name']:16} {'right' if one['right'] else 'WRONG'}  {one['said']}", flush=True)
    made = "\n".join(table(answers, held))
    print(made)
    if asked.write:
        page = PAGE.read_text(encoding="utf-8")
        before, after = page.partition(BEGIN)[0], page.partition(END)[2]
        PAGE.write_text(f"{before}{BEGIN}\n{made}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
