"""The result of a job as a file."""

from __future__ import annotations

import csv
import html
import io
import json
from collections.abc import Callable, Mapping

from mavcal.calib.firmware.export import to_param, to_params, to_parm
from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.firmware.values import shown
from mavcal.calib.report import fit_to_json, plan_to_json, verification_to_json
from mavcal.service.errors import ExportUnknown, PlanMissing
from mavcal.service.jobs.model import Job

MEDIA_TYPES: Mapping[str, str] = {
    "param": "text/plain",
    "parm": "text/plain",
    "params": "text/plain",
    "json": "application/json",
    "csv": "text/csv",
    "html": "text/html",
}


def export(job: Job, form: str) -> str:
    """The text of the file.

    Raises
    ------
    ExportUnknown
        If there is no such form.
    PlanMissing
        If the job has no plan.
    """
    makers: Mapping[str, Callable[[Job, WritePlan], str]] = {
        "param": lambda _job, plan: to_param(plan),
        "parm": lambda _job, plan: to_parm(plan),
        "params": lambda _job, plan: to_params(plan),
        "json": _json,
        "csv": _csv,
        "html": _html,
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
        "fits": [fit_to_json(fit) for fit in job.results],
        "plan": plan_to_json(plan),
        "verification": None if job.verification is None else verification_to_json(job.verification),
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


def _html(job: Job, plan: WritePlan) -> str:
    """One self-contained page that prints well."""
    verdicts = {} if job.verification is None else {v.name: v.verdict.value for v in job.verification.parameters}
    rows = [
        [c.name, _number(c.old), _number(c.new), _number(c.sd), c.unit, verdicts.get(c.name, ""), c.why]
        for c in plan.changes
    ]
    head = ["parameter", "before", "after", "± sd", "unit", "stream", "why"]
    losses = "".join(f"<li>{html.escape(x.text)} ({_number(x.cost)} {html.escape(x.unit)})</li>" for x in plan.losses)
    title = html.escape(f"{job.kind} calibration of {job.vehicle_id}")
    return (
        "<!doctype html><html lang='en'><meta charset='utf-8'>"
        f"<title>{title}</title><style>body{{font:15px/1.4 system-ui,sans-serif;margin:2rem;max-width:60rem}}"
        "table{border-collapse:collapse}td,th{border:1px solid #bbb;padding:.2rem .5rem;text-align:left}</style>"
        f"<h1>{title}</h1><p>Job {html.escape(job.id)}, state {job.state.value}, "
        f"firmware {html.escape(plan.fingerprint.firmware)}, plan {plan.sha256[:16]}.</p>"
        f"{_table(head, rows)}<h2>What the autopilot cannot hold</h2><ul>{losses or '<li>nothing</li>'}</ul></html>"
    )


def _table(head: list[str], rows: list[list[str]]) -> str:
    top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def _number(value: float | None) -> str:
    return "–" if value is None else shown(value, 7)
