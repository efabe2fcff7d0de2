"""``python -m bench.health LOG...``: every fault in every healthy log, and every log as it is.

The logs are healthy flights of the caller's own. Faults are found that were put in; what is called bad beside them is
counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mavcal.calib import logs
from mavcal.calib.health.finding import BAD
from mavcal.calib.health.report import health
from mavcal.calib.recording import Recording, Sensor
from tests.unit.health.faults import FAULTS, HealthFault, injected


@dataclass
class Tally:
    """One fault: sensors that got it, sensors where it was found, and runs in which another kind was called bad."""

    put: int = 0
    found: int = 0
    others: int = 0


def named_bad(recording: Recording) -> set[tuple[Sensor, int]]:
    """Sensors that are called suspicious or faulty."""
    return {(s.sensor, s.instance) for s in health(recording).sensors if s.verdict in BAD}


def tally(fault: HealthFault, healthy: dict[str, Recording]) -> Tally:
    """That fault in every unit of every log that can show it."""
    found = Tally()
    for recording in healthy.values():
        if not all(recording.find(sensor) for sensor in fault.needs):
            continue
        for instance in recording.instances(fault.sensor):
            bad = named_bad(injected(recording, fault, instance))
            found.put += 1
            found.found += (fault.sensor, instance) in bad
            found.others += bool({kind for kind, _ in bad if kind not in (fault.sensor, *fault.shared)})
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
    for name, bad in false.items():
        print(f"called bad in {name}: {sorted(bad)}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.health", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("logs", nargs="+", type=Path)
    asked = parser.parse_args()
    print("\n".join(rows({path.name: logs.read(path) for path in asked.logs})))


if __name__ == "__main__":
    main()
