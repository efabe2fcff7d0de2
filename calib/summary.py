"""Summary of an object for a console or a notebook: a title, a table and notes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from markupsafe import Markup

_PLACES = 8
"""Decimal places of a plain number; smaller ones are written with an exponent."""
_STYLE = "text-align:right;padding:0 0.8em"


@dataclass(frozen=True)
class Summary:
    """A title, rows of cells under `columns`, and notes in sentences; the first cell of a row names it."""

    title: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Plain lines for a console."""
        table = [self.columns, *self.rows] if self.rows else []
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "  " + "  ".join(c.rjust(w) if k else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True)))
            for row in table
        ]
        return "\n".join([self.title, *(line.rstrip() for line in lines), *(f"  {note}" for note in self.notes)])

    def html(self) -> str:
        """The summary as HTML for a notebook; every text is escaped."""
        out = [Markup("<p><b>{}</b></p>").format(self.title)]
        if self.rows:
            head = Markup().join(Markup('<th style="{}">{}</th>').format(_STYLE, c) for c in self.columns)
            body = Markup().join(Markup("<tr>{}</tr>").format(_cells(row)) for row in self.rows)
            out.append(Markup("<table><thead><tr>{}</tr></thead><tbody>{}</tbody></table>").format(head, body))
        if self.notes:
            items = Markup().join(Markup("<li>{}</li>").format(note) for note in self.notes)
            out.append(Markup("<ul>{}</ul>").format(items))
        return str(Markup().join(out))


def _cells(row: tuple[str, ...]) -> Markup:
    first = Markup('<th style="text-align:left">{}</th>').format(row[0])
    return first + Markup().join(Markup('<td style="{}">{}</td>').format(_STYLE, cell) for cell in row[1:])


def spread(value: float, sd: float) -> str:
    """A number to the two leading digits of its standard deviation; without one (0) to five digits.

    >>> spread(12.01349, 0.0213), spread(1.0, 0.0), spread(3.2, float("nan")), spread(1234.6, 120.0)
    ('12.013 ± 0.021', '1', 'undetermined', '1230 ± 120')
    >>> spread(-8.11e-9, 1.94e-8), spread(0.00012345, 2.5e-7)
    ('(-8 ± 19)e-9', '0.00012345 ± 0.00000025')
    """
    if math.isnan(sd):
        return "undetermined"
    if not sd > 0.0 or not math.isfinite(sd):
        return f"{value:.5g}"
    digits = 1 - math.floor(math.log10(sd))
    if digits > _PLACES:
        factor = 10.0**digits
        return f"({round(value * factor)} ± {round(sd * factor)})e-{digits}"
    places = max(0, digits)
    return f"{round(value, digits):.{places}f} ± {round(sd, digits):.{places}f}"


def counted(number: int) -> str:
    """A count with thin groups of three digits: ``124 960``."""
    return f"{number:,}".replace(",", " ")
