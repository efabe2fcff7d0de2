"""A finished picture, for a notebook or a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from markupsafe import Markup

from mavcal.calib.drawing.picture import Picture, side_by_side, text
from mavcal.calib.errors import InvalidInputError


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
    """Room without axes, with a word why there is nothing."""

    words: str
    width: int
    height: int

    def body(self) -> Markup:
        """Everything within the frame of the picture."""
        return text(self.width / 2, self.height / 2, self.words, anchor="middle") if self.words else Markup()


def sheet(panels: Sequence[Picture], heading: str, *, columns: int | None = None) -> Drawing:
    """Panels in rows of `columns` (None: one row) below a heading."""
    return Drawing(str(side_by_side(panels, heading, columns=columns, heading=heading)))
