"""Every method by its name: what the command line and the REST API run on a recording.

A method takes a :class:`~calib.recording.Recording` as it was read, and options by name. It undoes the calibration in
force where the recording is of a vehicle, and returns one fit a sensor instance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from mavcal.calib.methods.names import ENTRIES

if TYPE_CHECKING:
    from mavcal.calib.methods.method import Method

__all__ = ["METHODS", "MODULES"]

MODULES = tuple(dict.fromkeys(f"{__name__}.{entry.module}" for entry in ENTRIES.values()))
"""The modules that hold the methods."""


class _Methods(Mapping[str, "Method"]):
    """The methods by name; a method's module is loaded on first use."""

    def __getitem__(self, name: str) -> Method:
        methods: Sequence[Method] = import_module(f"{__name__}.{ENTRIES[name].module}").METHODS
        return next(method for method in methods if method.name == name)

    def __iter__(self) -> Iterator[str]:
        return iter(ENTRIES)

    def __len__(self) -> int:
        return len(ENTRIES)

    def __contains__(self, name: object) -> bool:
        return name in ENTRIES


METHODS: Mapping[str, Method] = _Methods()
"""Every method by its name."""
