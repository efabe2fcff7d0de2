"""``python -m bench.airframes DATA``: flights of different airframes, each compared with the calm one: is a sensor
named?

A vehicle that flies differently has no wrong sensor. Exit code 1: a sensor is named that is right, or one that is wrong
is not.
"""

from __future__ import annotations

import argparse
import json
import lzma
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mavcal.calib import gap, logs
from mavcal.calib.gap.schema import GapReport

SIMULATED = {"d": "d01sim.bin", "p": "p01.ulg"}
"""By the first letter of a flight's name, the calm one with nothing wrong."""
CALM_ITSELF = {"p01.ulg": "p02.ulg"}
"""Where a flight is itself the calm one, another with right sensors."""
SENSORS: Mapping[str, tuple[str, tuple[int, ...]]] = {"acc_scale": ("accel_scale", (1,))}
"""Ids of the labels that are of a sensor, as a report names them, and on which instances."""


@dataclass(frozen=True)
class Answer:
    """What was said of one flight: the names, each with its instances and probability, and processor seconds."""

    flight: str
    airframe: tuple[str, ...]
    known: Mapping[str, Sequence[int]]
    verdict: str
    named: tuple[tuple[str, tuple[int, ...], float], ...]
    unknown: str
    seconds: float

    @property
    def right(self) -> bool:
        """Whether exactly the wrong sensors are named, and nothing is called unknown."""
        said = {name: tuple(instances) for name, instances, _ in self.named}
        return said == {k: tuple(v) for k, v in self.known.items()} and not self.unknown


def flights(data: Path) -> list[tuple[str, tuple[str, ...], dict[str, tuple[int, ...]]]]:
    """Files of the folder with what their airframes and their sensors have."""
    found = []
    for label in json.loads((data / "labels.json").read_text(encoding="utf-8")):
        ids = [str(e["id"]) for e in label["effects"]]
        wrong = dict(SENSORS[i] for i in ids if i in SENSORS)
        wind = ["wind"] if float((label.get("wind") or {}).get("speed", 0.0)) > 0.0 else []
        airframe = (*(i for i in ids if i not in SENSORS), *wind)
        found.append((str(label["file"]).removesuffix(".gz"), airframe, wrong))
    return found


def unpacked(data: Path, name: str, folder: Path) -> Path:
    """A file of the data folder without its compression."""
    path = folder / name
    if not path.exists():
        path.write_bytes(lzma.decompress((data / f"{name}.xz").read_bytes()))
    return path


def answer(
    flight: tuple[str, tuple[str, ...], dict[str, tuple[int, ...]]], data: Path, folder: Path, *, nested: bool
) -> Answer:
    """One flight, diagnosed."""
    name, airframe, known = flight
    began = time.process_time()
    sim = CALM_ITSELF.get(name, SIMULATED[name[0]])
    report = gap.run(logs.read(unpacked(data, name, folder)), logs.read(unpacked(data, sim, folder)), nested=nested)
    return told(name, airframe, known, report, time.process_time() - began)


def told(
    name: str, airframe: tuple[str, ...], known: Mapping[str, Sequence[int]], report: GapReport, seconds: float
) -> Answer:
    """What a report says, in short."""
    named = tuple((e.id, tuple(e.instances), e.evidence.probability) for e in report.effects)
    unknown = (report.unknown.shape or "a rest") if report.unknown.flag else ""
    return Answer(name, airframe, known, report.verdict.value, named, unknown, seconds)


def row(one: Answer) -> str:
    """A line of the table in the docs."""
    named = ", ".join(f"`{i}` {' '.join(map(str, n))} ({p:.2f})" for i, n, p in one.named) or "-"
    unknown = f"; unknown: {one.unknown}" if one.unknown else ""
    differs = ", ".join(one.airframe) or "nothing"
    known = f"; {', '.join(one.known)}" if one.known else ""
    return (
        f"| `{one.flight}` | {differs}{known} | {one.verdict} | {named}{unknown} | "
        f"{'right' if one.right else 'wrong'} | {one.seconds:.0f} s |"
    )


HEADER = "| flight | what differs | verdict | named (probability) | | processor time |\n|---|---|---|---|---|---|"


def main(argv: Sequence[str] | None = None) -> int:
    """Every flight once, each told as soon as it is diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m bench.airframes", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the flights")
    parser.add_argument("--only", nargs="*", default=(), metavar="NAME", help="of these flights: d02 d08 …")
    parser.add_argument("--answers", type=Path, help="keep every answer, a JSON line each")
    parser.add_argument("--nested", action=argparse.BooleanOptionalAction, default=False)
    given = parser.parse_args(argv)
    print(HEADER, flush=True)
    right = True
    with tempfile.TemporaryDirectory(prefix="mavcal-airframes-") as folder:
        for flight in flights(given.data):
            if given.only and flight[0].partition(".")[0] not in given.only:
                continue
            one = answer(flight, given.data, Path(folder), nested=given.nested)
            print(row(one), flush=True)
            right = right and one.right
            if given.answers is not None:
                with given.answers.open("a", encoding="utf-8") as kept:
                    kept.write(json.dumps(asdict(one)) + "\n")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
