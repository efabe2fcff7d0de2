"""Pictures of a report's tables: where the gap is, and how far each effect closes it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from mavcal.calib.drawing import heat, svg, text
from mavcal.calib.gap.schema import LocatedGap, Shrink
from mavcal.calib.gap_report.colours import AFTER, BEFORE, FLOOR, MODEL
from mavcal.calib.gap_report.words import number, regime

_SLOTS = 6
_FAR = 1000
_LABEL = 130  # beside the longest bar
_LEAST_NATS = 1e-3  # of a sample: the faintest cell


def where_map(findings: Sequence[LocatedGap]) -> Markup:
    """Map of channels by regimes; stronger colour means more nats per sample."""
    if not findings:
        return Markup()
    ranges: dict[str, tuple[float, float]] = {}
    for f in findings:
        low, high = ranges.get(f.regime.kind, (math.inf, -math.inf))
        ranges[f.regime.kind] = (min(low, f.regime.bin[0]), max(high, f.regime.bin[1]))
    cells: dict[tuple[str, tuple[str, int]], LocatedGap] = {}
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
        (rows.index(row), columns.index(column), _level(f.nats_per_sample, strongest), _tooltip(f))
        for (row, column), f in cells.items()
    ]
    return heat(rows, labels, drawn, "Where the sensors differ: channel by operating regime", colour=BEFORE)


def _slot(found: LocatedGap, limits: tuple[float, float]) -> int:
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


def _tooltip(f: LocatedGap) -> str:
    return (
        f"{f.channel} of instance {f.instance}, {regime(f)}: {number(f.nats_per_sample)} nats a sample, "
        f"rms {number(f.rms)} {f.unit}, p {number(f.p_holm)}"
    )


def waterfall(shrink: Shrink) -> Markup:
    """Bars, in nats per sample: before, each effect's part, after, and floor."""
    gap = shrink.before - shrink.floor
    if not math.isfinite(gap) or gap <= 0.0:
        return Markup()
    steps: list[tuple[str, float, float, str]] = [("without any effect", 0.0, shrink.before, BEFORE)]
    level = shrink.before
    for step in shrink.sequence:
        reached = shrink.before - step.closed * gap
        steps.append((f"with {step.add}", reached, level, MODEL))
        level = reached
    steps.append(("left over", 0.0, shrink.after, AFTER))
    steps.append((f"floor ({shrink.floor_source.replace('_', ' ')})", 0.0, shrink.floor, FLOOR))
    top = max(max(a, b) for _, a, b, _ in steps)
    low = min(0.0, *(min(a, b) for _, a, b, _ in steps))
    left, wide, tall = 210.0, 330.0, 24.0
    out = []

    def across(value: float) -> float:
        return left + wide * (value - low) / (top - low)

    for i, (name, a, b, colour) in enumerate(steps):
        x, end, y = across(min(a, b)), across(max(a, b)), 8 + i * tall
        out.append(text(left - 8, y + 14, name, anchor="end"))
        bar = Markup('<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="17" style="fill:{}"/>')
        out.append(bar.format(x, y, max(end - x, 1.5), colour))
        out.append(text(end + 6, y + 13, f"down to {number(a)}" if colour == MODEL else number(b)))
    return svg(left + wide + _LABEL, 16 + tall * len(steps), out, "Gap on held-out data, one effect after the other")
