"""Pictures of a report's tables: where, how far, rivals, power."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from mavcal.calib.gap.schema import Finding, GapReport, Shrink
from mavcal.calib.gap_report.chart import heat, svg, text
from mavcal.calib.gap_report.words import number, quantity, regime

_SLOTS = 6
_FAR = 1000
_LABEL = 130  # beside the longest bar
_LEAST_NATS = 1e-3  # of a sample: the faintest cell


def where_map(findings: Sequence[Finding]) -> str:
    """Channels by regimes; the stronger the colour, the more nats a sample."""
    if not findings:
        return ""
    ranges: dict[str, tuple[float, float]] = {}
    for f in findings:
        low, high = ranges.get(f.regime.kind, (math.inf, -math.inf))
        ranges[f.regime.kind] = (min(low, f.regime.bin[0]), max(high, f.regime.bin[1]))
    cells: dict[tuple[str, tuple[str, int]], Finding] = {}
    for f in findings:
        key = (f"{f.channel} {f.instance}", (f.regime.kind, _slot(f, ranges[f.regime.kind])))
        if key not in cells or cells[key].nats_per_sample < f.nats_per_sample:
            cells[key] = f
    order = list(ranges)
    rows = sorted({row for row, _ in cells})
    columns = sorted({column for _, column in cells}, key=lambda c: (order.index(c[0]), c[1]))
    labels = [regime(next(f for (_, c), f in cells.items() if c == column)) for column in columns]
    strongest = max(f.nats_per_sample for f in findings)
    drawn = [
        (rows.index(row), columns.index(column), _level(f.nats_per_sample, strongest), _told(f))
        for (row, column), f in cells.items()
    ]
    return heat(rows, labels, drawn, "Where the sensors differ: channel by operating regime")


def _slot(found: Finding, limits: tuple[float, float]) -> int:
    low, high = found.regime.bin
    first, last = limits
    if found.regime.kind == "band":
        return -_FAR if low <= 0.0 else round(10.0 * math.log10(high))
    return int(_SLOTS * (0.5 * (low + high) - first) / (last - first)) if last > first else 0


def _level(nats: float, strongest: float) -> float:
    """0..1 on a logarithmic scale."""
    if strongest <= _LEAST_NATS:
        return 1.0
    return math.log(max(nats, _LEAST_NATS) / _LEAST_NATS) / math.log(strongest / _LEAST_NATS)


def _told(f: Finding) -> str:
    return (
        f"{f.channel} of instance {f.instance}, {regime(f)}: {number(f.nats_per_sample)} nats a sample, "
        f"rms {number(f.rms)} {f.unit}, p {number(f.p_holm)}"
    )


def waterfall(shrink: Shrink) -> str:
    """Before, each effect's part, after, floor: in nats a sample."""
    gap = shrink.before - shrink.floor
    if not math.isfinite(gap) or gap <= 0.0:
        return ""
    steps: list[tuple[str, float, float, str]] = [("without any effect", 0.0, shrink.before, "--before")]
    level = shrink.before
    for step in shrink.sequence:
        reached = shrink.before - step.closed * gap
        steps.append((f"with {step.add}", reached, level, "--model"))
        level = reached
    steps.append(("left over", 0.0, shrink.after, "--after"))
    steps.append((f"floor ({shrink.floor_source.replace('_', ' ')})", 0.0, shrink.floor, "--floor"))
    top = max(max(a, b) for _, a, b, _ in steps)
    low = min(0.0, *(min(a, b) for _, a, b, _ in steps))
    left, wide, tall = 210.0, 330.0, 24.0
    out = []

    def across(value: float) -> float:
        return left + wide * (value - low) / (top - low)

    for i, (name, a, b, colour) in enumerate(steps):
        x, end, y = across(min(a, b)), across(max(a, b)), 8 + i * tall
        out.append(text(left - 8, y + 14, name, anchor="end"))
        out.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(end - x, 1.5):.1f}" height="17" style="fill:var({colour})"/>'
        )
        out.append(text(end + 6, y + 13, f"down to {number(a)}" if colour == "--model" else number(b)))
    return svg(left + wide + _LABEL, 16 + tall * len(steps), out, "Gap on held-out data, one effect after the other")


def rivals_table(report: GapReport) -> str:
    """Effects against what could be taken for them: kappa as a bar, and what tells them apart."""
    pairs = [(e, r) for e in report.effects for r in e.confusable_with]
    if not pairs:
        return ""
    rows = "".join(
        f"<tr><td>{escape(e.id)}</td><td>{escape(r.id)}</td>"
        f'<td class="number"><span class="meter" style="--level:{min(max(r.kappa, 0.0), 1.0):.2f}">'
        f"{number(r.kappa)}</span></td><td class='number'>{number(r.delta)}</td><td>{escape(r.fix)}</td></tr>"
        for e, r in pairs
    )
    return (
        "<table><tr><th>found</th><th>could be taken for</th><th>alike (0 to 1)</th>"
        "<th>evidence for the found one</th><th>what would tell them apart</th></tr>"
        f"{rows}</table>"
    )


def power_table(report: GapReport) -> str:
    """The smallest effects that this recording would have shown."""
    if not report.power:
        return ""
    rows = "".join(
        f"<tr><td>{escape(p.id)}</td><td>{escape(p.name)}</td>"
        f'<td class="number">{escape(quantity(p.smallest, p.unit))}</td></tr>'
        for p in report.power
    )
    return f"<table><tr><th>effect</th><th>parameter</th><th>smallest that would show</th></tr>{rows}</table>"
