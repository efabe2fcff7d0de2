"""A method: its name, needs, options, and the function that runs it on a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import local_gravity
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult
from mavcal.calib.methods.names import ENTRIES
from mavcal.calib.methods.source import Source
from mavcal.calib.option import Option
from mavcal.calib.recording import Array, Channel, Recording
from mavcal.calib.stats.still_limits import HOLD_S

if TYPE_CHECKING:
    from mavcal.calib.methods.worthwhile import LoggedTrip

Options = Mapping[str, Any]
Fit = Callable[[Source, Options], Sequence[FitResult]]


class FindingKind(StrEnum):
    """What a method determines, worded for a sentence; it decides the possible exports of a fit."""

    CORRECTION = "a constant correction"
    DRIFT = "a correction that moves with temperature"
    MOTORS = "the field of the motors"
    FIGURES = "figures that belong to no correction"


MIN_STILL = Option("min_still", float, HOLD_S, "s for which a pose was held at least; shorter ones are no poses")
"""Option of every method that finds still poses itself."""
SPAN = (
    Option("from", float, None, "s on the recording's clock: nothing before it is used"),
    Option("until", float, None, "s on the recording's clock: nothing after it is used"),
)
"""Options of every method: the part of the recording to use."""


@dataclass(frozen=True)
class Suggestion:
    """Advice on a method for a vehicle's log."""

    order: int
    """Place among the suggestions."""
    judge: Callable[[LoggedTrip], tuple[bool, str]]
    """Whether the method is worthwhile on a log, and why (or why not)."""


@dataclass(frozen=True)
class Method:
    """A way to fit a sensor, with what it needs and the options that it takes."""

    name: str
    needs: str
    options: tuple[Option, ...]
    fit: Fit
    pool: Callable[[Sequence[Source], Options], Sequence[FitResult]] | None = None
    """Several logs of one vehicle together; None: the method takes one recording."""
    finds: FindingKind = FindingKind.CORRECTION
    suggestion: Suggestion | None = None
    """None: it is never advised for a log."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "options", (*self.options, *SPAN))

    @property
    def summary(self) -> str:
        """One line on what the method determines."""
        return ENTRIES[self.name].summary

    def run(self, recording: Recording, options: Options = MappingProxyType({})) -> tuple[FitResult, ...]:
        """The fits of every instance (or of the option ``instance``) that the recording has.

        Raises
        ------
        InvalidInputError
            If an option is unknown or of a wrong type, or the recording lacks the sensor.
        """
        chosen = _with_local_gravity(_checked(self, options))
        source = Source.of(_cut(recording, chosen), chosen["instance"])
        return tuple(source.annotated(fit) for fit in self.fit(source, chosen))

    def run_pooled(
        self, recordings: Sequence[Recording], options: Options = MappingProxyType({})
    ) -> tuple[FitResult, ...]:
        """The fits of several logs of one vehicle together; of one recording the same as :meth:`run`.

        Raises
        ------
        InvalidInputError
            If the method takes one recording only, or the logs are not of one vehicle.
        """
        if len(recordings) == 1:
            return self.run(recordings[0], options)
        if self.pool is None:
            raise InvalidInputError(f"{self.name} takes one recording, not {len(recordings)}")
        chosen = _with_local_gravity(_checked(self, options))
        if chosen["from"] is not None or chosen["until"] is not None:
            raise InvalidInputError("--from and --until cut one recording: fit these by themselves, or leave them out")
        sources = [Source.of(recording, chosen["instance"]) for recording in recordings]
        fits = self.pool(sources, chosen)
        for source in sources:
            fits = [source.annotated(fit) for fit in fits]
        return tuple(fits)


def of_one(pool: Callable[[Sequence[Source], Options], Sequence[FitResult]]) -> Fit:
    """The function of a method for one recording, out of that for several."""
    return lambda source, options: pool([source], options)


def _cut(recording: Recording, options: Options) -> Recording:
    """The part of `recording` that is asked for.

    Raises
    ------
    InvalidInputError
        If no sample lies within it.
    """
    start, end = options["from"], options["until"]
    if start is None and end is None:
        return recording
    first, last = recording.span
    low, high = first if start is None else float(start), last if end is None else float(end)
    part = recording.between(low, float(np.nextafter(high, np.inf)))
    if not np.isfinite(part.span[0]):
        asked = " and ".join(f"{name} {options[name]:g} s" for name in ("from", "until") if options[name] is not None)
        raise InvalidInputError(f"no sample lies {asked}: the recording has {first:.1f} to {last:.1f} s on its clock")
    return part


def _checked(method: Method, options: Options) -> dict[str, Any]:
    """Every option with its value, in its type.

    Raises
    ------
    InvalidInputError
        If one is unknown or does not have the type.
    """
    known = {option.name: option for option in method.options}
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise InvalidInputError(
            f"{method.name} has no option {', '.join(unknown)}; it takes {', '.join(sorted(known)) or 'none'}"
        )
    given = {name: options.get(name) for name in known}
    return {n: o.default if given[n] is None else o.check(o.from_text(given[n])) for n, o in known.items()}


INSTANCE = Option("instance", int, None, "only this instance, from 0; else every one that is there")
PLACE = (
    Option("latitude", float, None, "degrees: gravity of the place in place of the standard one"),
    Option("altitude", float, None, "m above the ellipsoid, with latitude; 0 where not said"),
)
"""Alternative to :data:`GRAVITY`: normal gravity at the place of the recording."""
GRAVITY = Option("gravity", float, None, "length of gravity in the unit of the samples; 9.80665 m/s2 where not said")
FIXTURE = Option("fixture_sd", float, 0.0, "tilt of the fixture, standard deviation in degrees")


def mean_or_none(values: Sequence[float] | Array) -> float | None:
    """Mean of the finite ones; None if there are none."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(finite.mean()) if len(finite) else None


def _with_local_gravity(chosen: dict[str, Any]) -> dict[str, Any]:
    """The options with the gravity of the stated place.

    Raises
    ------
    InvalidInputError
        If gravity is stated as well, or an altitude without a latitude.
    """
    latitude, altitude = chosen.get("latitude"), chosen.get("altitude")
    if latitude is None:
        if altitude is not None:
            raise InvalidInputError(f"an altitude of {altitude:g} m without a latitude says nothing of gravity")
        return chosen
    if chosen["gravity"] is not None:
        raise InvalidInputError(f"state gravity ({chosen['gravity']:g}) or the latitude ({latitude:g}), not both")
    return {**chosen, "gravity": local_gravity(latitude, altitude or 0.0)}


def gravity_of(options: Options, accel: Channel) -> float:
    """Length of gravity in the unit of `accel`.

    Raises
    ------
    InvalidInputError
        If the unit is not m/s2 and nothing is stated.
    """
    in_si = accel.unit == "m/s2"
    if options["gravity"] is not None and (in_si or options.get("latitude") is None):
        return float(options["gravity"])
    if not in_si:
        raise InvalidInputError(f"gravity in {accel.unit} is not known: state it with --gravity")
    return STANDARD_GRAVITY
