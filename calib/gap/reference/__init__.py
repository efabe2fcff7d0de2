"""From recordings to a :class:`calib.gap.problem.GapProblem`: every sensor beside what an ideal one would have read.

Several references may apply (GAP 3.5b); the best available one is used and named. It is recorded in ``ref_*`` columns
or by a simulator on the same trajectory (:mod:`ideal`). It may also be a pose that drives an ideal sensor
(:mod:`companion_with_pose`), or another instance on the same vehicle (:mod:`redundant`).
"""

from mavcal.calib.gap.reference.best_reference import companion_with_pose, have_separate_poses, is_another_flight
from mavcal.calib.gap.reference.build import build, prepared
from mavcal.calib.gap.reference.channels import with_common_channels

__all__ = [
    "build",
    "companion_with_pose",
    "have_separate_poses",
    "is_another_flight",
    "prepared",
    "with_common_channels",
]
