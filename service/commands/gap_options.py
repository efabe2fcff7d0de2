"""What ``mavcal gap`` and ``mavcal gap close`` share: options of frame, mass and time, and progress on one line."""

from __future__ import annotations

import math
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TextIO

import click

if TYPE_CHECKING:
    from mavcal.calib.gap import GapProgress

FRAMES = (
    "quad-plus", "quad-x", "quad-h", "quad-betaflight-x", "quad-dji-x", "quad-clockwise-x",
    "quad-betaflight-x-reversed",
    "hexa-plus", "hexa-x", "hexa-dji-x", "hexa-clockwise-x", "octa-plus", "octa-x",
)  # fmt: skip
"""Those of ``calib.airframe.geometry.NAMED``, stated here so that help does without numpy (a test compares them)."""
LIMIT_S = 60.0
"""That of ``calib.gap.DEFAULT_LIMIT_S``, for the same reason."""

_WIDTH = 78
"""Columns of the line."""


class NumberRange(click.FloatRange):
    """A number of a range; infinity may be one, nan is none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number, or a sentence why not."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is no number", param, ctx)
        return number


class FiniteRange(NumberRange):
    """A number of a range that is not infinite either."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number, or a sentence why not."""
        number = super().convert(value, param, ctx)
        if math.isinf(number):
            self.fail(f"{value} is no finite number", param, ctx)
        return number


layout_option = click.option(
    "--frame",
    "layout",
    type=click.Choice(FRAMES),
    default=None,
    help="The frame of the vehicle, where its recording does not say it.",
)
sim_frame_option = click.option(
    "--sim-frame",
    "frame",
    default=None,
    metavar="FILE",
    help="The frame (JSON) that ArduPilot's simulator flew with, on which the remedy builds; else the stock one.",
)
mass_option = click.option(
    "--mass",
    type=FiniteRange(min=0.0, min_open=True),
    default=None,
    metavar="KG",
    help="The real vehicle's mass, for the remedy: a flight shows only thrust, drag and inertia over the mass.",
)


class Line:
    """One line of a terminal whose text changes.

    Parameters
    ----------
    stream
        Where to; None: stderr.
    quiet_s
        Where there is no terminal, a text becomes a line of its own if so many seconds have passed since the one
        before; None: nothing is written.
    """

    def __init__(self, stream: TextIO | None = None, quiet_s: float | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._quiet_s = quiet_s
        self._last, self._when = "", -math.inf

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.clear()

    def write(self, text: str) -> None:
        """Overwrite the line."""
        if text == self._last:
            return
        if self._stream.isatty():
            self._stream.write(f"\r{text[:_WIDTH]:{_WIDTH}}\r")
        elif text and self._quiet_s is not None and time.monotonic() - self._when > self._quiet_s:
            self._when = time.monotonic()
            self._stream.write(f"{text}\n")
        self._stream.flush()
        self._last = text

    def clear(self) -> None:
        """Erase the line, before output that stays."""
        self.write("")


class Gauge(Line):
    """Writes to a terminal how far a diagnosis is; writes nothing where there is none."""

    def show(self, standing: GapProgress) -> None:
        """Show how far the diagnosis is."""
        self.write(sentence(standing))


def sentence(standing: GapProgress) -> str:
    """``selecting effects: 34 % done, about 20 s left``."""
    left = "" if standing.left_s is None else f", about {max(round(standing.left_s), 1)} s left"
    return f"{standing.text}: {100 * standing.share:.0f} % done{left}"
