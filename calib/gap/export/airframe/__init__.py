"""Effects of the airframe as settings of simulators, solved together so that no setting undoes another."""

from mavcal.calib.gap.export.airframe.patch import Patch, airframe_effects, airframe_patch, own_patches

__all__ = ["Patch", "airframe_effects", "airframe_patch", "own_patches"]
