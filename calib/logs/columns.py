"""Columns of numbers in a text file, whatever their names."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UnreadableError

Array = NDArray[np.float64]

SEPARATORS = (",", ";", "\t", None)  # None: any run of blanks
COMMENTS = ("#", "%", "//")
_MISSING = frozenset({"na", "n/a", "null", "none", "-", "--", "missing"})
_SAMPLE = 400  # lines from which separator and number of columns are found
_MOST_TEXT = 1 << 28  # bytes of text: rows of text cost many times their size while they are read
_MOST_BAD = 0.1  # share of damaged rows beyond which a file is not a table


@dataclass(frozen=True, eq=False)
class TableColumns:
    """Equally long columns with their names; texts of the cells are kept where they are not numbers.

    `names` are those of the header, or "" for columns without one; a column is found by its name or 0-based number.
    """

    names: tuple[str, ...]
    values: tuple[Array, ...]
    texts: dict[int, tuple[str, ...]]
    damage: str = ""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values[0]) if self.values else 0

    def index(self, wanted: str) -> int:
        """Number of the column called `wanted`, else the column of that number.

        Raises
        ------
        UnreadableError
            If there is none; the message lists what there is.
        """
        for matches in (wanted.__eq__, lambda name: name.lower() == wanted.lower()):
            found = [i for i, name in enumerate(self.names) if matches(name)]
            if found:
                return found[0]
        if wanted.isdecimal() and int(wanted) < len(self.values):
            return int(wanted)
        raise UnreadableError(f"there is no column {wanted!r}; the table has {self.listed()}")

    def listed(self) -> str:
        """The columns in words."""
        named = [name for name in self.names if name]
        if not named:
            return f"{len(self.values)} columns without names: map them by number, --map mag_x=0,mag_y=1,mag_z=2"
        return ", ".join(named[:40])


def text_columns(data: bytes) -> TableColumns:
    """The table in a text: comma, semicolon, tab or blanks between cells; comments and a preamble may precede it.

    Raises
    ------
    UnreadableError
        If the text is no table.
    """
    if len(data) > _MOST_TEXT:
        raise UnreadableError(
            f"the text has {len(data) >> 20} MB: at most {_MOST_TEXT >> 20} are read; save it as .npz, or cut it"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if "\0" in text:
        raise UnreadableError(
            "the file is neither text nor a format that is known: give a table (.csv, .npz) or a .tlog"
        )
    lines = [line.strip("\r\n \ufeff") for line in text.split("\n")]
    bodies = [(line if not line.startswith(COMMENTS) else "") for line in lines]
    filled = [i for i, line in enumerate(bodies) if line]
    if not filled:
        raise UnreadableError("the file holds no table: it is empty or has nothing but comments")
    separator, width = _layout([bodies[i] for i in _sampled(filled)])
    cells = {i: _split(bodies[i], separator, width) for i in filled}
    start = next((i for i in filled if len(cells[i]) == width and _is_data(cells[i])), None)
    if start is None:
        raise UnreadableError("the file holds no rows of numbers: is it a table?")
    names, above = _header(lines[:start], separator, width)
    rows = [cells[i] for i in filled if i > above]
    good = [row for row in rows if len(row) == width]
    bad = len(rows) - len(good)
    if bad > max(1, _MOST_BAD * len(rows)):
        raise UnreadableError(f"{bad} of {len(rows)} rows do not have {width} columns: the table is damaged")
    damage = f"{bad} of {len(rows)} rows do not have {width} columns and were left out" if bad else ""
    return _columns(names, good, damage)


def _sampled(filled: list[int]) -> list[int]:
    """Sample of lines from the beginning and from the middle, which is beyond any preamble."""
    middle = len(filled) // 2
    return filled[: _SAMPLE // 2] + filled[middle : middle + _SAMPLE // 2]


def _layout(lines: list[str]) -> tuple[str | None, int]:
    """The separator, and the number of columns, that make most of `lines` rows of numbers."""
    best: tuple[float, str | None, int] = (0.0, None, 0)
    for separator in SEPARATORS:
        rows = [_split(line, separator, None) for line in lines]
        width, count = Counter(len(row) for row in rows).most_common(1)[0]
        numeric = sum(_is_data(row) for row in rows if len(row) == width)
        score = numeric + 0.01 * count if width > 1 or separator is None else 0.0
        if score > best[0] and numeric:
            best = (score, separator, width)
    if not best[2]:
        raise UnreadableError("the file holds no rows of numbers: is it a table?")
    return best[1], best[2]


def _split(line: str, separator: str | None, width: int | None) -> list[str]:
    cells = [cell.strip().strip('"') for cell in line.split(separator)]
    while width is not None and len(cells) > width and not cells[-1]:
        cells.pop()
    return cells


def _is_data(cells: list[str]) -> bool:
    numbers = sum(_number(cell) is not None for cell in cells)
    texts = sum(bool(cell) for cell in cells) - numbers
    return numbers > 0 and texts <= 0.5 * len(cells)


def _number(cell: str) -> float | None:
    """The number in a cell, nan for a missing-value marker; None if the cell is empty or a text."""
    if cell.lower() in _MISSING:
        return np.nan
    try:
        return float(cell)
    except ValueError:
        pass
    try:
        return float(cell.replace(",", "."))  # decimal commas, where the separator is another
    except ValueError:
        return None


def _header(lines: list[str], separator: str | None, width: int) -> tuple[tuple[str, ...], int]:
    """Names from the nearest line above the data that has as many cells, a comment's included, and its number.

    Without one, everything above the data is a preamble.
    """
    for row in reversed(range(len(lines))):
        bare = lines[row].lstrip("#%/ ").strip()
        cells = _split(bare, separator, width)
        if bare and len(cells) == width and not any(_number(cell) is not None for cell in cells):
            return tuple(cells), row
    return ("",) * width, len(lines) - 1


def _columns(names: tuple[str, ...], rows: list[list[str]], damage: str) -> TableColumns:
    values, texts = [], {}
    for k in range(len(names)):
        cells = [row[k] for row in rows]
        try:
            values.append(np.array(cells, dtype=np.float64))
            continue
        except ValueError:
            pass
        numbers = [_number(cell) for cell in cells]
        values.append(np.array([np.nan if number is None else number for number in numbers]))
        if any(number is None and cell for number, cell in zip(numbers, cells, strict=True)):
            texts[k] = tuple("" if cell.lower() in _MISSING else cell for cell in cells)
    return TableColumns(names, tuple(values), texts, damage)
