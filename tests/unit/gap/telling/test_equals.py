"""What the error of a re-estimated attitude makes the same is named together."""

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

ACROSS, ALONG = np.array([0.1, 0.44, 0.0]), np.array([0.1, 0.44, 0.3])
ESTIMATOR = ReferenceInfo(ReferenceKind.ESTIMATOR, 0.8)


def effect_of(offset, *, kind=ReferenceKind.ESTIMATOR, only=None, reference=ESTIMATOR, heave=0.3):
    """Two accelerometers that hardly tilt and heave by `heave` m/s2, and an offset of both, or of one."""
    reference = dataclasses.replace(reference, kind=kind)
    rng = np.random.default_rng(1)
    whole = problem_of(rng, (Sensor.ACCEL,), instances=2, reference=reference)
    traces = []
    for k, trace in enumerate(whole.traces):
        waves = np.sin(trace.t[:, None] * [0.5, 0.7, 0.9])
        force = np.array([0.0, 0.0, -9.80665]) + waves * [0.6, 0.6, heave]
        measured = force + SIGMA[Sensor.ACCEL] * rng.normal(size=force.shape)
        measured = measured + (offset if only in (None, k) else 0.0)
        traces.append(dataclasses.replace(trace, ideal=force, force=force, measured=measured))
    problem = dataclasses.replace(whole, traces=tuple(traces))
    (effect,) = diagnose(problem, effects=(by_id()["accel_bias"],), nested=False).effects
    return effect


@pytest.mark.long
def test_an_offset_of_both_across_gravity_names_the_tilt_of_both():
    effect = effect_of(ACROSS)
    assert effect.instances == (1, 2)
    assert "accel_rotation" in {rival.id for rival in effect.confusable_with}
    assert effect.evidence.doubtful or effect.evidence.probability <= 0.5


@pytest.mark.long
@pytest.mark.parametrize(
    ("offset", "more"), [(ALONG, {}), (ACROSS, {"kind": ReferenceKind.SIM}), (ACROSS, {"only": 1})]
)
def test_what_tells_them_apart_is_used(offset, more):
    effect = effect_of(offset, **more)
    assert "accel_rotation" not in {rival.id for rival in effect.confusable_with}


@pytest.mark.long
@pytest.mark.parametrize(("scale_sd", "named"), [(0.02, True), (0.0005, False)])
def test_an_offset_along_gravity_is_a_scale_as_well_where_the_trajectory_leaves_scales_open(scale_sd, named):
    """Both units 2 % too large read 0.19 m/s2 too much; the report named an offset alone, with 0.97."""
    reference = dataclasses.replace(ESTIMATOR, accel_sd=(scale_sd,) * 3)
    effect = effect_of(np.array([0.0, 0.0, -0.19]), reference=reference, heave=3.0)
    assert ("accel_scale" in {rival.id for rival in effect.confusable_with}) is named
