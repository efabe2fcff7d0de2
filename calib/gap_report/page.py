"""One self-contained page: no scripts, nothing from elsewhere; whatever came from a file is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from mavcal.calib.gap.schema import EffectEstimate, GapReport
from mavcal.calib.gap_report.series_plots import (
    allan_plot,
    of_effect,
    overlay,
    shape_plot,
    spectrum_plot,
    strip,
)
from mavcal.calib.gap_report.style import STYLE
from mavcal.calib.gap_report.table_plots import power_table, rivals_table, waterfall, where_map
from mavcal.calib.gap_report.words import (
    closed_sentence,
    effect_phrase,
    interval,
    not_compared,
    number,
    quantity,
    regime,
    verdict_sentence,
)

_MOST_SHAPES = 12
_MOST_SERIES = 9
_MOST_WHERE = 8


def gap_to_html(report: GapReport, *, title: str = "Sim-to-real gap") -> str:
    """The report as a page.

    Parameters
    ----------
    report
        Of a diagnosis; its `series` make the pictures, and are left out where it has none.
    title
        Of the page, such as the name of the recording.
    """
    sections = [
        _head(report, title),
        _effects(report),
        _shrink(report),
        _where(report),
        _shapes(report),
        _spectra(report),
        _rivals(report),
        _time(report),
        _overlays(report),
        _limits(report),
        _inputs(report),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>{''.join(sections)}</body></html>\n"
    )


def _section(heading: str, sentence: str, body: str) -> str:
    if not body:
        return ""
    return f'<section><h2>{escape(heading)}</h2><p>{escape(sentence)}</p><div class="wide">{body}</div></section>'


def _figures(pictures: Iterable[str]) -> str:
    drawn = "".join(f"<figure>{p}</figure>" for p in pictures if p)
    return f'<div class="row">{drawn}</div>' if drawn else ""


def _head(report: GapReport, title: str) -> str:
    said = escape(verdict_sentence(report))
    lines = [f"<b>{said}</b>", escape(closed_sentence(report.shrink))] if report.effects else [f"<b>{said}</b>"]
    if report.unknown.flag or report.unknown.shape:
        lines.append(
            escape(
                f"Not explained: {report.unknown.shape or 'a rest'} ({100 * report.unknown.share:.0f} % of the gap)."
            )
        )
    if missing := not_compared(report):
        lines.append(f"<b>{escape(missing)}</b>")
    warnings = "".join(f"<li>{escape(w)}</li>" for w in report.warnings)
    body = "<br>".join(lines)
    return (
        f'<h1>{escape(title)}</h1><p class="soft">What the real sensors read, compared with what simulated ones would '
        f'have read: verdict <code>{report.verdict.value}</code>.</p><div class="verdict">{body}</div>'
        + (f"<ul>{warnings}</ul>" if warnings else "")
    )


def _effects(report: GapReport) -> str:
    rows = "".join(_effect_rows(e) for e in report.effects)
    table = f"<table><tr><th>effect</th><th>parameter</th><th>value</th><th>95 % interval</th></tr>{rows}</table>"
    return _section(
        "Which effects",
        "What has to be added to the simulator so that it reads like the real sensors: each value is added to, or "
        "multiplies, an ideal sensor.",
        table if rows else "",
    )


def _effect_rows(effect: EffectEstimate) -> str:
    phrase = effect_phrase(effect)
    phrase = phrase[0].upper() + phrase[1:]
    held = {True: "holds on held-out data", False: "does not hold on held-out data", None: "not held out"}
    about = (
        f"<b>{escape(phrase)}</b><br><span class='soft'>probability {number(effect.evidence.probability)}, "
        f"{100.0 * effect.evidence.share:.0f} % of what all effects explain; "
        f"{held[effect.gates.heldout_blocks]}</span>{_patch(effect)}"
    )
    count = max(len(effect.params), 1)
    rows = []
    for i, p in enumerate(effect.params):
        first = f'<td rowspan="{count}">{about}</td>' if i == 0 else ""
        rows.append(
            f"<tr>{first}<td>{escape(p.name)}</td><td class='number'>{escape(quantity(p.value, p.unit))}</td>"
            f"<td class='number'>{interval(*p.ci95)}</td></tr>"
        )
    return "".join(rows) or f"<tr><td>{about}</td><td></td><td></td><td></td></tr>"


def _patch(effect: EffectEstimate) -> str:
    if not effect.sim_patch:
        return ""
    names = ", ".join(f"{name} {value:.6g}" for name, value in effect.sim_patch.items() if value)
    return f"<br><span class='soft'>ArduPilot simulator: <code>{escape(names)}</code></span>" if names else ""


def _shrink(report: GapReport) -> str:
    shrink = report.shrink
    if shrink is None:
        return ""
    rows = "".join(
        f"<tr><td>{escape(sensor)}</td><td class='number'>{number(before)}</td><td class='number'>{number(after)}</td>"
        f"<td>{escape(unit)}</td></tr>"
        for sensor, (before, after, unit) in shrink.rms.items()
    )
    table = f"<table><tr><th>sensor</th><th>rms before</th><th>rms after</th><th>unit</th></tr>{rows}</table>"
    return _section(
        "How far the gap shrinks",
        "How badly parts of the recording that were kept aside are predicted (lower is better), while one effect after "
        "the other is added. A nat is a factor of 2.7 in how likely the readings are: 0.01 nats a sample are a factor "
        "of 2.7 in every hundred samples.",
        (f"<figure>{picture}</figure>" if (picture := waterfall(shrink)) else "") + (table if rows else ""),
    )


def _where(report: GapReport) -> str:
    top = report.where[:_MOST_WHERE]
    rows = "".join(
        f"<tr><td>{escape(f.channel)}</td><td>{f.instance}</td><td>{escape(regime(f))}</td>"
        f"<td class='number'>{number(f.nats_per_sample)}</td>"
        f"<td class='number'>{number(f.rms)} {escape(f.unit)}</td></tr>"
        for f in top
    )
    table = (
        "<table><tr><th>channel</th><th>instance</th><th>when</th><th>nats a sample</th><th>rms</th></tr>"
        f"{rows}</table>"
    )
    return _section(
        "Where",
        "Each row is an axis of a sensor, each column a condition of the flight; the stronger the colour, the "
        "more the sensor differs there. Empty cells show nothing beyond the noise.",
        f"<figure>{where_map(report.where)}</figure>{table}" if rows else "",
    )


def _shapes(report: GapReport) -> str:
    pictures = []
    shown = [effect.id for effect in report.effects]
    shown += [name for series in report.series for name in series.parts]  # shapes that are not of the catalogue too
    for name in list(dict.fromkeys(shown))[:_MOST_SHAPES]:
        series = of_effect(report.series, name)
        pictures.append("" if series is None else shape_plot(series, name))
    return _section(
        "What the effects look like",
        "What the real sensor read beyond the ideal one, over what the effect follows: dots with intervals before the "
        "effect is added, its fitted curve, and what remains after. After should lie on zero.",
        _figures(pictures),
    )


def _spectra(report: GapReport) -> str:
    pictures: list[str] = []
    for series in report.series[:_MOST_SERIES]:
        pictures += [spectrum_plot(series), allan_plot(series)]
    return _section(
        "Noise",
        "The difference by frequency, and by averaging time: where the line after lies on the model's noise, nothing "
        "is left to explain.",
        _figures(pictures),
    )


def _rivals(report: GapReport) -> str:
    return _section(
        "What these data cannot tell apart",
        "Other explanations of the same data, how alike they are here, and the manoeuvre that would decide.",
        rivals_table(report),
    )


def _time(report: GapReport) -> str:
    drawn = "".join(f"<figure>{p}</figure>" for p in strip(report.series[:_MOST_SERIES], report.effects))
    return _section(
        "Over time",
        "The size of the difference in units of the noise (1 is noise alone), before and after, above the conditions "
        "of the flight.",
        drawn,
    )


def _overlays(report: GapReport) -> str:
    return _section(
        "Real, simulated, corrected",
        "A few seconds in which the effects matter most: the simulation with the effects should lie on the real line.",
        _figures(overlay(series) for series in report.series[:_MOST_SERIES]),
    )


def _limits(report: GapReport) -> str:
    rows = "".join(
        f"<tr><td>{escape(n.id)}</td><td>{escape(n.reason)}</td><td>{escape(n.need)}</td></tr>"
        for n in report.not_testable
    )
    table = f"<table><tr><th>sensor or effect</th><th>why not</th><th>what it needs</th></tr>{rows}</table>"
    return _section(
        "Not testable here",
        "Effects that this recording could not have shown, which is not the same as their absence.",
        table if rows else "",
    ) + _section(
        "How small an effect would have shown",
        "The size at which an effect would have been found in this recording every second time.",
        power_table(report),
    )


def _inputs(report: GapReport) -> str:
    inputs, tests = report.inputs, report.multiple_testing
    facts: Sequence[tuple[str, str]] = (
        ("reference", f"{inputs.reference_kind}: {inputs.reference_text}"),
        ("attitude error of the reference", f"{number(inputs.att_sigma_deg)} degrees"),
        ("recording", f"{number(inputs.duration_s)} s at up to {number(inputs.fs_hz)} samples a second"),
        ("tests made", f"{tests.m}; chance of any false report {number(tests.alpha_family)}"),
        ("sha256 of the real recording", inputs.real_sha256 or "not known"),
        ("sha256 of the simulated recording", inputs.sim_sha256 or "none"),
        ("sha256 of the diagnoser", inputs.diagnoser_sha256),
    )
    rows = "".join(f"<tr><td>{escape(a)}</td><td><code>{escape(b)}</code></td></tr>" for a, b in facts)
    return _section(
        "What was compared",
        "The files, the reference and the program, for whoever repeats it.",
        f"<table>{rows}</table>",
    )
