"""Compares what must not be lost with what store and disk hold after the last life of the service."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.campaign.truth import equal
from mavcal.calib.report import to_json
from mavcal.service.jobs.journal import JournalStep
from mavcal.service.store import Store
from mavcal.service.store.rows import JournalRow

_SETTLED = {JournalStep.ECHO, JournalStep.UNDONE, JournalStep.LEFT, JournalStep.RESTORED}
_ANNOUNCED = {JournalStep.SEND, JournalStep.UNDO, JournalStep.RESTORE}


def lost(ledger: Path, store: Store) -> list[str]:
    """Sentences on what the ledger says the store had taken and the store no longer has."""
    complaints = []
    jobs = {row.id for row in store.jobs()}
    rows: dict[str, list[str]] = {}
    for line in ledger.read_text().splitlines():
        what, arguments = json.loads(line)
        if what == "save_job":
            if arguments[0]["id"] not in jobs:
                complaints.append(f"job {arguments[0]['id']} is lost")
        elif what == "add_journal":
            rows.setdefault(arguments[0], []).append(_row(arguments[2], arguments[3]))
        elif what == "add_plan" and store.plan(arguments[0], arguments[1]) is None:
            complaints.append(f"plan {arguments[1][:12]} is lost")
        elif what == "close_segment":
            kept = [to_json(segment) for segment in store.segments(arguments[0]["job_id"])]
            if arguments[0] not in kept:
                complaints.append(f"segment {arguments[0]['id']} is lost or is another one")
    for job_id, taken in rows.items():
        held = iter([_row(row.step, to_json(row.data)) for row in store.journal(job_id)])
        complaints += [f"the journal has lost {row}" for row in taken if row not in held]  # in the same order
    return list(dict.fromkeys(complaints))


def _row(step: str, data: Any) -> str:
    return f"{step} {json.dumps(data, sort_keys=True)}"


def damaged(store: Store) -> list[str]:
    """Segments whose samples are not those that were accepted."""
    complaints = []
    for job in store.jobs():
        for segment in store.segments(job.id):
            if segment.end_byte is None:
                continue
            data = segment.path.read_bytes()[segment.start_byte : segment.end_byte]
            if hashlib.sha256(data).hexdigest() != segment.sha256:
                complaints.append(f"the samples of segment {segment.id} are not those that were accepted")
    return complaints


def recorded(data_dir: Path) -> dict[Path, tuple[int, str]]:
    """Length and digest of every telemetry log."""
    logs = {path: path.read_bytes() for path in (data_dir / "tlogs").glob("*.tlog")}
    return {path: (len(data), hashlib.sha256(data).hexdigest()) for path, data in logs.items()}


def overwritten(before: Mapping[Path, tuple[int, str]]) -> list[str]:
    """Telemetry logs that do not begin any more with what they held."""
    return [
        f"{path.name} has lost samples"
        for path, (length, digest) in before.items()
        if hashlib.sha256(path.read_bytes()[:length]).hexdigest() != digest
    ]


def contradicted(
    journal: Sequence[JournalRow], stored: Mapping[str, float], foreign: Mapping[str, float], excused: Iterable[str]
) -> list[str]:
    """Parameters whose value on the vehicle is not the one that the journal confirms last."""
    claimed: dict[str, float | None] = {}
    for row in journal:
        if row.step == JournalStep.ACCEPTED:
            claimed = {}
        elif row.step in _SETTLED:
            claimed[row.data["name"]] = row.data["value"]
        elif row.step in _ANNOUNCED:
            claimed[row.data["name"]] = None
    return [
        f"the journal says that {name} is {value:.9g}, the vehicle holds {stored[name]:.9g}"
        for name, value in claimed.items()
        if value is not None
        and name not in excused
        and not equal(stored[name], value)
        and not (name in foreign and equal(stored[name], foreign[name]))
    ]
