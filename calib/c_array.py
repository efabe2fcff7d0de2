"""A correction as one homogeneous 4 x 4 matrix, and as an array of C."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


def homogeneous(matrix: ArrayLike, offset: ArrayLike) -> Array:
    """The H (4, 4) with ``H [m, 1] = [C (m - b), 1]`` for `matrix` C (3, 3) and `offset` b (3,).

    >>> homogeneous(2.0 * np.eye(3), [1.0, 0.0, 0.0])[0] + 0.0
    array([ 2.,  0.,  0., -2.])
    """
    C, b = np.asarray(matrix, dtype=np.float64), np.asarray(offset, dtype=np.float64)
    whole = np.eye(4)
    whole[:3, :3] = C
    whole[:3, 3] = -C @ b
    return whole


def c_array(name: str, values: ArrayLike) -> str:
    """`values` (rows, columns) as the definition of a ``static const double`` array; every digit comes back.

    Raises
    ------
    InvalidInputError
        If `name` is no identifier of C, or a value is not finite.

    >>> print(c_array("mag_0", [[1.0, 0.5], [0.0, 1.0]]))
    static const double mag_0[2][2] = {
        {1.0, 0.5},
        {0.0, 1.0},
    };
    """
    array = np.asarray(values, dtype=np.float64)
    if not _IDENTIFIER.match(name):
        raise InvalidInputError(f"{name!r} is no name of an array in C: letters, digits and underscores")
    if array.ndim != 2 or not np.isfinite(array).all():
        raise InvalidInputError(f"an array of C is made of finite rows and columns, not of shape {array.shape}")
    rows = "".join(f"    {{{', '.join(map(repr, row))}}},\n" for row in array.tolist())
    return f"static const double {name}[{array.shape[0]}][{array.shape[1]}] = {{\n{rows}}};"
