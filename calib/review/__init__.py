"""Review of a plan: errors before and after, criteria, mountings, and a picture."""

from __future__ import annotations

from mavcal.calib.review.criteria import Criterion, criteria_of
from mavcal.calib.review.effect import ErrorCurve, SensorEffect, effects_of, headline_of
from mavcal.calib.review.mountings import MountingChoice, StatedMounting, choices_of, mountings_of
from mavcal.calib.review.picture import picture_of

__all__ = [
    "Criterion",
    "ErrorCurve",
    "MountingChoice",
    "SensorEffect",
    "StatedMounting",
    "choices_of",
    "criteria_of",
    "effects_of",
    "headline_of",
    "mountings_of",
    "picture_of",
]
