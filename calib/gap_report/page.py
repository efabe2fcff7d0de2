"""One self-contained page without scripts or external files; text from recordings is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from mavcal.calib import pages
from mavcal.calib.airframe.answer import AirframePart, Domain
from mavcal.calib.gap.schema import GapReport
from mavcal.calib.gap_report import airframe_effects, airframe_words, words
from mavcal.calib.gap_report.flight_plots import LEGEND, rollout_plots, trace_plots
from mavcal.calib.gap_report.series_plots import allan_plot, of_effect, overlay, shape_plot, spectrum_plot, strip
from mavcal.calib.gap_report.table_plots import waterfall, where_map
from mavcal.calib.gap_report.vehicle_plot import vehicle_plot

_MOST_SHAPES = 12
_MOST_SERIES = 9
_MOST_WHERE = 8


def gap_to_html(report: GapReport, *, title: str = "Sim-to-real gap") -> str:
    """The report as a page.

    Parameters
    ----------
    report
        A diagnosis; its `series` make the pictures. Without series there are none.
    title
        Title of the page, such as the name of the recording.
    """
    sensors = airframe_words.effects_of(report, Domain.SENSOR)
    return pages.page(
        "mavcal.calib.gap_report",
        "report.html",
        title=title,
        report=report,
        pictures=_pictures(report),
        sensors=sensors,
        vehicle=[group for group in airframe_words.groups(report) if group[1][0].domain is not Domain.SENSOR],
        rivals=[(effect, rival) for effect in sensors for rival in effect.confusable_with],
        facts=_facts(report),
        most_where=_MOST_WHERE,
        words=words,
        airframe_effects=airframe_effects,
        airframe_words=airframe_words,
        legend=LEGEND,
    )


@dataclass(frozen=True)
class _Pictures:
    """The pictures of a page; empty where the report has no data for one."""

    waterfall: Markup
    where: Markup
    shapes: Sequence[Markup]
    spectra: Sequence[Markup]
    strip: Sequence[Markup]
    overlays: Sequence[Markup]
    vehicle: Markup
    traces: Sequence[Sequence[Markup]]
    """A row of charts for each trace: force, then torque."""
    rollouts: Sequence[Markup]


def _pictures(report: GapReport) -> _Pictures:
    series = [fit for fit in report.series if np.nan_to_num(fit.residual).any()][:_MOST_SERIES]  # units may be equal
    airframe = report.airframe or AirframePart()
    return _Pictures(
        waterfall=Markup() if report.shrink is None else waterfall(report.shrink),
        where=where_map(report.where),
        shapes=_drawn(_shapes(report)),
        spectra=_drawn(draw(fit) for fit in series for draw in (spectrum_plot, allan_plot)),
        strip=strip(series, report.effects),
        overlays=_drawn(overlay(fit) for fit in series),
        vehicle=vehicle_plot(airframe, report.effects),
        traces=[drawn for trace in airframe.traces if (drawn := trace_plots(trace))],
        rollouts=rollout_plots(airframe.rollout),
    )


def _drawn(pictures: Iterable[Markup]) -> list[Markup]:
    return [picture for picture in pictures if picture]


def _shapes(report: GapReport) -> Iterable[Markup]:
    shown = [effect.id for effect in airframe_words.effects_of(report, Domain.SENSOR)]
    shown += [name for series in report.series for name in series.parts]  # shapes that are not of the catalogue too
    for name in list(dict.fromkeys(shown))[:_MOST_SHAPES]:
        series = of_effect(report.series, name)
        if series is not None:
            yield shape_plot(series, name)


def _facts(report: GapReport) -> Sequence[tuple[str, str]]:
    """Facts on the comparison, by name."""
    inputs, tests = report.inputs, report.multiple_testing
    flown = report.airframe
    of_flight = () if flown is None else tuple((n.replace("_", " "), words.number(v)) for n, v in flown.facts.items())
    return (
        ("reference", f"{inputs.reference_kind}: {inputs.reference_text}"),
        ("attitude error of the reference", f"{words.number(inputs.att_sigma_deg)} degrees"),
        ("recording", f"{words.number(inputs.duration_s)} s at up to {words.number(inputs.fs_hz)} samples a second"),
        ("tests made", f"{tests.m}; chance of any false report {words.number(tests.alpha_family)}"),
        *of_flight,
        ("sha256 of the real recording", inputs.real_sha256 or "not known"),
        ("sha256 of the simulated recording", inputs.sim_sha256 or "none"),
        ("sha256 of the diagnoser", inputs.diagnoser_sha256),
    )
