"""Everything about a recording in one document: its sensors' health, what is in it, and which fits are worthwhile."""

from __future__ import annotations

from typing import Any

from mavcal.calib.flight.report import flight_report
from mavcal.calib.health.dead import living
from mavcal.calib.health.report import HealthReport, health
from mavcal.calib.logs.inspection import inspect
from mavcal.calib.methods.worthwhile import LoggedTrip, advice
from mavcal.calib.recording import Recording


def overview(recording: Recording, found: HealthReport | None = None) -> dict[str, Any]:
    """What is in a recording (:func:`calib.logs.inspection.inspect`), with ``health``, ``flight`` and ``next``.

    ``health`` (`found` where that was judged already) is None for a recording whose spans are labelled by hand, such
    as faces: that is a bench, not a flight. ``flight`` is the sanity of a vehicle's inertial sensors, ``next`` the fits
    that are worthwhile on it and those that are not; both are None for a recording that is not of a vehicle.
    """
    if found is None and not recording.segments:
        found = health(recording)
    heard = recording if found is None else living(recording, found.silent)
    report = flight_report(heard, None if found is None else found.shaking)
    trip = None if report is None else LoggedTrip(heard, report.rests, report.ground)
    return {
        **inspect(recording),
        "health": None if found is None else found.document,
        "flight": None if report is None else report.document,
        "next": None if trip is None else [one.document for one in advice(trip)],
    }
