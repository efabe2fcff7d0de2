"""Which vehicles or uploads a campaign goes through."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol


class Selectable(Protocol):
    """Something with an id."""

    @property
    def id(self) -> str:
        """Its id."""
        ...


@dataclass(frozen=True)
class Selection:
    """Those of `ids`, or all that there are; `ids` None: all."""

    ids: tuple[str, ...] | None = None


def selected(vehicles: Iterable[Selectable], selection: Selection) -> Sequence[str]:
    """Ids of the vehicles of a selection, in its order.

    One that is named and not among `vehicles` stays: it may be heard later, and else its item says that it was not.
    """
    return tuple(vehicle.id for vehicle in vehicles) if selection.ids is None else selection.ids
