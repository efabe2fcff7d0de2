"""Ids of shapes that no effect of the catalogue has: ``unknown:<family>:<text>``, a part's ``unknown:one <family>:…``.

An id beside the catalogue's says what its price goes by, and never names an effect.
"""

from __future__ import annotations

_PREFIX = "unknown"
_PART = "one "


def shape_id(family: str, text: str, *, part: bool = False) -> str:
    """Id of a shape of that family; `part`: it is one of many amplitudes that were looked through."""
    return f"{_PREFIX}:{_PART * part}{family}:{text}"


def is_shape(effect_id: str) -> bool:
    """Whether it is the id of a shape, and no name."""
    return effect_id.startswith(_PREFIX)


def family_of(shape: str) -> str:
    """The family in a shape's id."""
    return shape.split(":")[1].removeprefix(_PART)


def is_part(shape: str) -> bool:
    """Whether a shape's id is that of one of many that were looked through."""
    return shape.split(":")[1].startswith(_PART)
