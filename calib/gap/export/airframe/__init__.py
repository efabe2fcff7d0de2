"""Effects of the airframe as settings of simulators: all at once, so that one setting takes nothing back of another."""

from mavcal.calib.gap.export.airframe.patch import Patch, airframe_effects, airframe_patch, own_patches

__all__ = ["Patch", "airframe_effects", "airframe_patch", "own_patches"]
