"""Options that ``mavcal gap`` and ``mavcal gap close`` have in common: frame, mass and time."""

from __future__ import annotations

import math
from typing import Any

import click

FRAMES = (
    "quad-plus", "quad-x", "quad-h", "quad-betaflight-x", "quad-dji-x", "quad-clockwise-x",
    "quad-betaflight-x-reversed",
    "hexa-plus", "hexa-x", "hexa-dji-x", "hexa-clockwise-x", "octa-plus", "octa-x",
)  # fmt: skip
"""Those of ``calib.airframe.geometry.NAMED``, stated here so that help does without numpy (a test compares them)."""
LIMIT_S = 60.0
"""That of ``calib.gap.DEFAULT_LIMIT_S``, for the same reason."""


class FiniteRange(click.FloatRange):
    """A number of a range that is neither infinite nor none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number, or a sentence why not."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
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
