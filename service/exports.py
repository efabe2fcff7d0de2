"""The result of a job as a file."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping
from functools import partial

from mavcal.calib.firmware.export import ParameterFormat, write_plan
from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.firmware.values import shown
from mavcal.calib.pages import page
from mavcal.calib.report import to_json
from mavcal.service.errors import ExportUnknown, PlanMissing
from mavcal.service.jobs.core.model import Job
from mavcal.service.reviews import reviewed
from mavcal.service.store.sql import Store

PICTURES_A_ROW = 2
"""Number of pictures that fit the width of a sheet of paper."""
MEDIA_TYPES: Mapping[str, str] = {
    "param": "text/plain",
    "parm": "text/plain",
    "params": "text/plain",
    "json": "application/json",
    "csv": "text/csv",
    "html": "text/html",
}


def export(job: Job, form: str, store: Store) -> str:
    """The text of the file; a page reads the store, so not for the event loop.

    Raises
    ------
    ExportUnknown
        If there is no such form.
    PlanMissing
        If the job has no plan.
    """
    makers: Mapping[str, Callable[[Job, WritePlan], str]] = {
        **dict.fromkeys(ParameterFormat, lambda _job, plan: write_plan(plan, ParameterFormat(form))),
        "json": _json,
        "csv": _csv,
        "html": partial(_html, store=store),
    }
    if form not in makers:
        raise ExportUnknown(f"there is no export .{form}; there are {', '.join(makers)}")
    if job.plan is None:
        raise PlanMissing(f"job {job.id} is {job.state} and has no plan to export")
    return makers[form](job, job.plan)


def _json(job: Job, plan: WritePlan) -> str:
    document = {
        "job": {"id": job.id, "kind": job.kind, "vehicle": job.vehicle_id, "options": dict(job.options)},
        "state": job.state.value,
        "created_at": job.created_at,
        "fits": to_json(job.results),
        "plan": to_json(plan),
        "verification": to_json(job.verification),
        "segments": [
            {"name": s.path.name, "start": s.start_byte, "end": s.end_byte, "sha256": s.sha256} for s in job.segments
        ],
    }
    return json.dumps(document, indent=1, allow_nan=False)


def _csv(_job: Job, plan: WritePlan) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["parameter", "old", "new", "sd", "unit", "why"])
    for change in plan.changes:
        writer.writerow([change.name, change.old, repr(change.new), change.sd, change.unit, change.why])
    return text.getvalue()


def _html(job: Job, plan: WritePlan, store: Store) -> str:
    """One self-contained page that prints well."""
    verdicts = {} if job.verification is None else {v.name: v.verdict.value for v in job.verification.parameters}
    review = reviewed(job, plan, store, PICTURES_A_ROW)
    return page(
        "mavcal.service",
        "export.html",
        job=job,
        plan=plan,
        review=review,
        verdicts=verdicts,
        number=_number,
        rough=_rough,
    )


def _number(value: float | None) -> str:
    return "–" if value is None else shown(value, 7)


def _rough(value: float | None) -> str:
    """A standard deviation with its significant digits."""
    return "–" if value is None else shown(value, 2)
