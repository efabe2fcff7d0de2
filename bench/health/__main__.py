"""``python -m bench.health LOG... [--write]``: every fault in every healthy log, and every log as it is.

The logs are healthy flights of the caller's own. With ``--write`` the table goes to ``docs/health.md``, between the
marks that stand there.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.health.faults import FAULTS, HealthFault, injected
from mavcal.calib import logs
from mavcal.calib.health.finding import BAD
from mavcal.calib.health.report import health
from mavcal.calib.recording import Recording, Sensor

PAGE = Path(__file__).resolve().parents[2] / "docs" / "health.md"
BEGIN, END = "<!-- measured -->", "<!-- end of what was measured -->"


@dataclass
class Tally:
    """One fault: sensors that got it, sensors where it was found, and runs in which another kind was called bad."""

    put: int = 0
    found: int = 0
    others: int = 0
    missed: list[str] = field(default_factory=list)


def named_bad(recording: Recording) -> set[tuple[Sensor, int]]:
    """Sensors that are called suspicious or faulty."""
    return {(s.sensor, s.instance) for s in health(recording).sensors if s.verdict in BAD}


def tally(fault: HealthFault, healthy: dict[str, Recording]) -> Tally:
    """That fault in every unit of every log that can show it."""
    found = Tally()
    for name, recording in healthy.items():
        if not all(recording.find(sensor) for sensor in fault.needs):
            continue
        for instance in recording.instances(fault.sensor):
            bad = named_bad(injected(recording, fault, instance))
            found.put += 1
            found.found += (fault.sensor, instance) in bad
            found.others += bool({kind for kind, _ in bad if kind not in (fault.sensor, *fault.shared)})
            if (fault.sensor, instance) not in bad:
                found.missed.append(f"{name}, unit {instance + 1}")
    return found


def rows(healthy: dict[str, Recording]) -> Iterator[str]:
    """The table."""
    sensors = {name: len(health(recording).sensors) for name, recording in healthy.items()}
    false = {name: bad for name, recording in healthy.items() if (bad := named_bad(recording))}
    yield "| fault | units | found | another kind of sensor called bad as well |"
    yield "|---|---|---|---|"
    yield f"| none | {sum(sensors.values())} in {len(healthy)} logs | {sum(map(len, false.values()))} called bad | |"
    for fault in FAULTS:
        one = tally(fault, healthy)
        yield f"| {fault.name} | {one.put} | {one.found} | {one.others} |"
        if one.missed:
            print(f"missed {fault.name}: {'; '.join(one.missed[:8])}")
    for name, bad in false.items():
        print(f"called bad in {name}: {sorted(bad)}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.health", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE.name}")
    asked = parser.parse_args()
    table = "\n".join(rows({path.name: logs.read(path) for path in asked.logs}))
    print(table)
    if asked.write:
        page = PAGE.read_text(encoding="utf-8")
        before, after = page.partition(BEGIN)[0], page.partition(END)[2]
        PAGE.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
