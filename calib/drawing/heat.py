"""A table of coloured cells."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from mavcal.calib.drawing.legend import LETTER
from mavcal.calib.drawing.picture import svg, text

_STEEP = 0.87
"""Height per letter width of the rotated column names."""


def heat(
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Sequence[tuple[int, int, float, str]],
    title: str,
    *,
    colour: str,
) -> Markup:
    """A table of coloured cells: (row, column, 0..1, tooltip); missing cells are blank."""
    left, wide, tall = 128.0, 17.0, 17.0
    longest = LETTER * max(map(len, columns), default=0)
    top = 14.0 + _STEEP * longest
    out = []
    for j, name in enumerate(columns):
        x = left + (j + 0.65) * wide
        turned = Markup('<g transform="translate({:.1f} {:.1f}) rotate(-60)">{}</g>')
        out.append(turned.format(x, top - 6, text(0, 0, name)))
    for i, name in enumerate(rows):
        out.append(text(left - 6, top + (i + 0.7) * tall, name, anchor="end"))
        rule = Markup('<path class="grid" d="M{} {:.1f}h{:.1f}"/>')
        out.append(rule.format(left, top + i * tall, wide * len(columns)))
    for i, j, level, words in cells:
        place = (left + j * wide, top + i * tall, wide - 1, tall - 1)
        out.append(
            Markup(
                '<rect x="{:.1f}" y="{:.1f}" width="{:.0f}" height="{:.0f}" style="fill:{}" '
                'fill-opacity="{:.2f}"><title>{}</title></rect>'
            ).format(*place, colour, 0.12 + 0.88 * min(max(level, 0.0), 1.0), words)
        )
    return svg(left + wide * len(columns) + 0.5 * longest, top + tall * len(rows) + 8, out, title)
