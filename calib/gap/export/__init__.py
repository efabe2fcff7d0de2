"""The remedy of a gap: its effects as parameters of a simulator, or as a calibration of the vehicle."""

from mavcal.calib.gap.export.airframe import Patch, airframe_patch
from mavcal.calib.gap.export.airframe.frame import frame_from_text
from mavcal.calib.gap.export.files import ENDINGS, Exported, Target, exported, target_of
from mavcal.calib.gap.export.sitl import SitlPatch, patch, with_patches

__all__ = [
    "ENDINGS",
    "Exported",
    "Patch",
    "SitlPatch",
    "Target",
    "airframe_patch",
    "exported",
    "frame_from_text",
    "patch",
    "target_of",
    "with_patches",
]
