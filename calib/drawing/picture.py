"""Words, dots and frames of a picture, and the finished picture for a page, a notebook or a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]

_RULES = (
    "text{font-size:10.5px;fill:#1d2b36}",
    ".title{font-size:12.5px;font-weight:600}",
    ".heading{font-size:14px;font-weight:600}",
    ".grid{fill:none;stroke:#dfe5ea}",
    ".edge{fill:none;stroke:#6b7a86}",
)
SHEET = Markup(" ").join(Markup(".drawn {}").format(rule) for rule in _RULES)
"""Style of an SVG file, without effect on a notebook around it; a page has its own rules for the same classes."""
_HEADING = 30


class Picture(Protocol):
    """Something that is drawn into a frame."""

    @property
    def width(self) -> int:
        """Width of the frame."""

    @property
    def height(self) -> int:
        """Height of the frame."""

    def body(self) -> Markup:
        """Everything within the frame."""


def text(x: float, y: float, words: str, *, anchor: str = "start", kind: str = "") -> Markup:
    """Text at a position; `kind` is a class of the style sheet."""
    style = Markup(' class="{}"').format(kind) if kind else ""
    return Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}"{}>{}</text>').format(x, y, anchor, style, words)


def dotted(x: Array, y: Array, colour: str, *, size: float, opacity: float = 0.75) -> Markup:
    """A dot at each position, all in one path."""
    path = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x, y, strict=True))
    return Markup(
        '<path d="{}" fill="none" style="stroke:{}" stroke-width="{:g}" stroke-linecap="round" opacity="{:g}"/>'
    ).format(path, colour, 2 * size, opacity)


def svg(width: float, height: float, parts: Iterable[Markup], title: str) -> Markup:
    """A picture inside a page, with its words for those who cannot see it."""
    return Markup('<svg viewBox="0 0 {:.0f} {:.0f}" width="{:.0f}" role="img" aria-label="{}">{}</svg>').format(
        width, height, width, title, Markup().join(parts)
    )


def side_by_side(
    pictures: Sequence[Picture], alt_text: str, *, columns: int | None = None, heading: str = ""
) -> Markup:
    """An SVG with pictures in rows of `columns` (None: one row); `alt_text` serves screen readers."""
    across = columns or len(pictures)
    rows = [pictures[i : i + across] for i in range(0, len(pictures), across)]
    width = max(sum(p.width for p in row) for row in rows)
    y, groups = 0, []
    if heading:
        y += _HEADING
        groups.append(text(width / 2, 19, heading, anchor="middle", kind="heading"))
    for row in rows:
        x = 0
        for picture in row:
            groups.append(Markup('<g transform="translate({} {})">{}</g>').format(x, y, picture.body()))
            x += picture.width
        y += max(p.height for p in row)
    fonts = Markup('class="drawn" font-family="Helvetica, Arial, sans-serif"')
    frame = Markup('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {0} {1}" width="{0}" height="{1}" {2}').format(
        width, y, fonts
    )
    paper = Markup('<rect width="{}" height="{}" fill="#ffffff"/>').format(width, y)
    return Markup('{} role="img" aria-label="{}"><style>{}</style>{}{}</svg>\n').format(
        frame, alt_text, SHEET, paper, Markup().join(groups)
    )


@dataclass(frozen=True)
class Drawing:
    """A picture as SVG, which every browser and every notebook shows."""

    svg: str = field(repr=False)
    """The file, as text."""

    def save(self, path: str | Path) -> None:
        """Write it to a file.

        Raises
        ------
        InvalidInputError
            If `path` does not end in ``.svg``.
        """
        target = Path(path)
        if target.suffix.lower() != ".svg":
            raise InvalidInputError(f"a picture is an SVG: save {target.name} as .svg")
        target.write_text(self.svg, encoding="utf-8")

    def _repr_svg_(self) -> str:
        return self.svg


@dataclass(frozen=True)
class Blank:
    """An empty panel that states why nothing is drawn."""

    words: str
    width: int
    height: int

    def body(self) -> Markup:
        """Everything within the frame of the picture."""
        return text(self.width / 2, self.height / 2, self.words, anchor="middle") if self.words else Markup()


def sheet(panels: Sequence[Picture], heading: str, *, columns: int | None = None) -> Drawing:
    """Panels in rows of `columns` (None: one row) below a heading."""
    return Drawing(str(side_by_side(panels, heading, columns=columns, heading=heading)))
