"""Columns of numbers out of text, .npz and .mat files, whatever they are called there."""

from __future__ import annotations

import io
import math
import struct
import warnings
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass

import numpy as np
import scipy.io
from numpy.typing import NDArray

from calib.errors import UnreadableError

Array = NDArray[np.float64]

SEPARATORS = (",", ";", "\t", None)  # None: any run of blanks
COMMENTS = ("#", "%", "//")
_MAT_COMPRESSED = 15  # miCOMPRESSED
_MISSING = frozenset({"na", "n/a", "null", "none", "-", "--", "missing"})
_SAMPLE = 400  # lines from which separator and number of columns are found
_MOST_TEXT = 1 << 28  # bytes of text: rows of text cost many times their size while they are read
_MOST_UNFOLDED = 1 << 26, 200  # bytes that a packed file may unfold to, plus this many times its own size
_MOST_BAD = 0.1  # share of damaged rows beyond which a file is not a table


@dataclass(frozen=True, eq=False)
class Columns:
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


def text_columns(data: bytes) -> Columns:
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


def npz_columns(data: bytes) -> Columns:
    """The arrays of an .npz; one of shape (N, k) called a becomes a_0, a_1 ... (accel, gyro, mag: a_x, a_y, a_z).

    Raises
    ------
    UnreadableError
        If the file is damaged, or its arrays are not of numbers.
    """
    try:
        _check_members(data)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except UnreadableError:
        raise
    except Exception as error:  # zipfile and numpy meet damage with a dozen kinds of them
        raise UnreadableError(
            f"the .npz cannot be read ({error}): write it with numpy.savez and arrays of numbers"
        ) from error
    return _from_arrays(arrays)


def mat_columns(data: bytes) -> Columns:
    """The arrays of a MATLAB file, in the same manner as :func:`npz_columns`.

    Raises
    ------
    UnreadableError
        If the file is damaged, or of MATLAB's 7.3 format (HDF5).
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of scipy, about variables that no table needs
            _check_elements(data)
            content = scipy.io.loadmat(io.BytesIO(data))
    except NotImplementedError as error:  # what scipy raises for the HDF5 of version 7.3
        raise UnreadableError("the .mat is of MATLAB's 7.3 format: save it with -v7, or as .csv") from error
    except UnreadableError:
        raise
    except Exception as error:  # a damaged file makes scipy raise anything
        raise UnreadableError(f"the .mat cannot be read ({error}): save it with -v7, or as .csv") from error
    return _from_arrays({name: value for name, value in content.items() if not name.startswith("__")})


def _check_members(data: bytes) -> None:
    """Refuse archives whose members unfold beyond reason, and arrays that claim more than their member holds."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        _check_unfolded(sum(member.file_size for member in members), len(data))
        for member in members:
            if not member.filename.endswith(".npy"):
                continue
            with archive.open(member) as opened:
                version = np.lib.format.read_magic(opened)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(opened)
            if math.prod(shape) * dtype.itemsize > member.file_size:
                raise UnreadableError(f"the .npz is damaged: {member.filename} claims {shape} of {dtype}")


def _check_elements(data: bytes) -> None:
    """Refuse a MATLAB 5 file whose compressed elements unfold beyond reason."""
    order = "<" if data[126:128] == b"IM" else ">"
    place, total = 128, 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if kind == _MAT_COMPRESSED:
            unpacker, packed = zlib.decompressobj(), data[place + 8 : place + 8 + size]
            while packed and not unpacker.eof:
                total += len(unpacker.decompress(packed, 1 << 20))
                _check_unfolded(total, len(data))
                packed = unpacker.unconsumed_tail
        place += 8 + size


def _check_unfolded(total: int, size: int) -> None:
    least, times = _MOST_UNFOLDED
    if total > least + times * size:
        raise UnreadableError(f"the file of {size} bytes unfolds to {total >> 20} MB or more: that is no recording")


def _from_arrays(arrays: dict[str, NDArray[np.generic]]) -> Columns:
    flat = {
        name: np.asarray(a) for name, a in arrays.items() if np.asarray(a).ndim in (1, 2) and np.asarray(a).size > 1
    }
    if not flat:
        raise UnreadableError("the file holds no arrays")
    lengths = Counter(max(a.shape) for a in flat.values())
    rows = lengths.most_common(1)[0][0]
    names: list[str] = []
    values: list[Array] = []
    texts: dict[int, tuple[str, ...]] = {}
    for name, given in flat.items():
        array = given.reshape(rows, -1) if given.size == rows else given
        if array.shape[0] != rows and array.ndim == 2 and array.shape[1] == rows:
            array = array.T
        if array.shape[0] != rows:
            continue
        array = array.reshape(rows, -1)
        for k in range(array.shape[1]):
            column = array[:, k]
            if column.dtype.kind in "US":
                texts[len(values)] = tuple(str(cell) for cell in column)
                values.append(np.full(rows, np.nan))
            elif column.dtype.kind in "biuf":
                values.append(column.astype(np.float64))
            else:
                continue
            names.append(_array_name(name, k, array.shape[1]))
    if not values:
        raise UnreadableError("the file holds no arrays of numbers")
    return Columns(tuple(names), tuple(values), texts)


def _array_name(name: str, column: int, width: int) -> str:
    if width == 1:
        return name
    if width == 3 and name.rstrip("0123456789") in {"accel", "gyro", "mag"}:
        return f"{name}_{'xyz'[column]}"
    if width == 4 and name == "q":
        return f"q_{'wxyz'[column]}"
    return f"{name}_{column}"


def _sampled(filled: list[int]) -> list[int]:
    """Lines from the beginning and from the middle, where a preamble no longer counts."""
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
    """The number in a cell, nan if it says that there is none; None if it is empty or a text."""
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


def _columns(names: tuple[str, ...], rows: list[list[str]], damage: str) -> Columns:
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
    return Columns(names, tuple(values), texts, damage)
