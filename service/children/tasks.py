"""The tasks of children: each takes its order and a callback for progress, and returns JSON values.

A task is named ``module:function``; only names in the service's own code are ever run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavcal.calib.methods import MODULES
from mavcal.service.progress_line import ProgressLine, format_line

if TYPE_CHECKING:
    from mavcal.calib.gap import GapProgress

Json = dict[str, Any]
OnProgress = Callable[[str], None]

INSPECT = "mavcal.service.children.tasks:inspect"
FIT = "mavcal.service.children.tasks:fit"
DIAGNOSE = "mavcal.service.children.tasks:diagnose"
SERIES = "mavcal.service.children.tasks:series"

FIRST = ("mavcal.calib.logs", "mavcal.calib.flight.report", "mavcal.calib.report")
LATER = (
    *(
        "scipy.special",
        "scipy.linalg",
        "scipy.spatial",
        "scipy.fft",
        "scipy.ndimage",
        "scipy.signal",
    ),  # what `calib` computes with
    *(*MODULES, "mavcal.calib.gap", "mavcal.calib.gap.schema", "mavcal.calib.gap_report"),
)
"""Modules that the fork server imports for its children, before it serves and while it is idle."""
_EVERY_S = 0.5
"""Least time between two lines about one stage of a diagnosis."""


def inspect(order: Mapping[str, Any], on_progress: OnProgress) -> Json:
    """The contents of the recording ``{path, reading}``."""
    from mavcal.calib import logs
    from mavcal.calib.methods.overview import overview
    from mavcal.calib.report import to_json

    on_progress("reading")
    found: Json = to_json(overview(logs.read(Path(order["path"]), **order["reading"])))
    return found


def fit(order: Mapping[str, Any], on_progress: OnProgress) -> Json:
    """Fits by a method, ``{path, reading, method, options, origin}``; with `origin` also whose sensors they are."""
    from mavcal.calib import logs
    from mavcal.calib.firmware.in_force.origin import origin_of
    from mavcal.calib.methods import METHODS
    from mavcal.calib.report import to_json

    on_progress("reading")
    recording = logs.read(Path(order["path"]), **order["reading"])
    on_progress("fitting")
    fits = METHODS[order["method"]].run(recording, order["options"])
    origin = to_json(origin_of(recording, fits)) if order["origin"] else None
    return {"fits": to_json(fits), "origin": origin}


def series(order: Mapping[str, Any], on_progress: OnProgress) -> Json:
    """The sensors of the recording ``{path, reading}`` as series for a picture."""
    from mavcal.calib import logs
    from mavcal.calib.flight.series import series_of
    from mavcal.calib.report import to_json

    on_progress("reading")
    return {"series": to_json(series_of(logs.read(Path(order["path"]), **order["reading"])))}


def diagnose(order: Mapping[str, Any], on_progress: OnProgress) -> Json:
    """The gap of ``{real, sim, nominal}``, each ``{path, reading, sha256}`` or None: a sentence and the report.

    With `title` also its page; `without` leaves effects out, `nested` is as in :func:`calib.gap.run`. `limit_s` is the
    processor time after which the best answer so far is given: None for as long as it takes; where it is left out, that
    of :mod:`calib.gap`. The answer is given after `wall_s` by the clock as well, where that is there. `seconds` is the
    time of the diagnosis alone. A digest may be left out.
    """
    asked, spent = time.monotonic(), time.process_time()
    from mavcal.calib import gap, logs
    from mavcal.calib.gap.schema import as_json
    from mavcal.calib.gap_report import gap_to_html
    from mavcal.calib.gap_report.words import verdict_sentence

    def read(part: Mapping[str, Any]) -> Any:
        return logs.read(Path(part["path"]), **part.get("reading", {}))

    on_progress("reading")
    real = read(order["real"])
    sim = None if order["sim"] is None else read(order["sim"])
    nominal = tuple(read(part) for part in order["nominal"])
    hashes = {role: part["sha256"] for role in ("real", "sim") if "sha256" in (part := order[role] or {})}
    on_progress("diagnosing")
    began = time.perf_counter()
    limit = order.get("limit_s", gap.DEFAULT_LIMIT_S)
    limit = math.inf if limit is None else limit
    wall = order.get("wall_s", math.inf)
    if wall < limit:
        limit = wall

    def elapsed() -> float:
        """Processor time used, s; or, if larger, the used share of the wall-clock limit in the same scale."""
        by_clock = (time.monotonic() - asked) * (limit / wall) if math.isfinite(wall) else 0.0
        return max(time.process_time() - spent, by_clock)

    pace = gap.GapPace(elapsed, limit, _seldom(on_progress))
    report = gap.run(
        real,
        sim,
        nominal,
        without=order.get("without", ()),
        nested=order.get("nested", True),
        inputs=hashes or None,
        pace=pace,
        frame=order.get("frame"),
    )
    return {
        "seconds": time.perf_counter() - began,
        "summary": verdict_sentence(report, listed=False),
        "report": as_json(report),
        "page": gap_to_html(report, title=order["title"]) if "title" in order else None,
    }


def _seldom(on_progress: OnProgress) -> Callable[[GapProgress], None]:
    """Reports every stage of a diagnosis, but at most a few steps a second."""
    reported_at: dict[str, float] = {}

    def show(standing: GapProgress) -> None:
        now = time.monotonic()
        if now - reported_at.get(standing.stage, -math.inf) < _EVERY_S:
            return
        reported_at[standing.stage] = now
        on_progress(format_line(ProgressLine(standing.text, standing.share, standing.left_s)))

    return show
