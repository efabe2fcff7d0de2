"""A compass's drift with temperature: which axes repeat, and what one pose cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.thermal import compass
from mavcal.calib.thermal.compass import fit_mag_thermal

POSES = (np.array([20.0, 5.0, 42.0]), np.array([-38.0, 12.0, -15.0]))
OFFSET_DRIFT = np.array([0.06, 0.0, -0.09])  # uT/degC
SENSITIVITY = 0.004  # 1/degC, of the y axis
TEMPERATURE = 35.0 - 12.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 3000))


def pose(number, rng, *, sensitivity=0.0, drift=OFFSET_DRIFT, field=None):
    field = POSES[number] if field is None else field
    d = (TEMPERATURE - 25.0)[:, None]
    values = field + d * drift + d * sensitivity * field * [0.0, 1.0, 0.0] + 0.3 * rng.normal(size=(3000, 3))
    return Channel(Sensor.MAG, 0, np.arange(3000.0), values, "uT", Stage.RAW, "test"), TEMPERATURE


def test_a_drift_of_the_offset_repeats_in_every_pose():
    rng = np.random.default_rng(1)
    fit = fit_mag_thermal([pose(0, rng), pose(1, rng)])
    assert fit.status == FitStatus.PARTIAL
    assert "x, z repeat" in fit.message
    found = fit.model.polynomial.coefficients[:, 0]
    assert (np.abs(found - OFFSET_DRIFT)[[0, 2]] < 4.0 * fit.sd[[12, 14]]).all()
    assert "poly1_y" in fit.undetermined
    assert any("the slope of y is" in text and "too uncertain" in text for text in fit.warnings)


def test_a_drift_of_the_sensitivity_goes_with_the_field():
    rng = np.random.default_rng(2)
    poses = [pose(k, rng, sensitivity=SENSITIVITY, field=POSES[k] * [1.0, 3.0 * (1 - 2 * k), 1.0]) for k in (0, 1)]
    fit = fit_mag_thermal(poses)
    assert "poly1_y" in fit.undetermined
    assert any("the slope of y is" in text and "its sensitivity drifts" in text for text in fit.warnings)


def test_one_pose_cannot_tell_what_drifts():
    fit = fit_mag_thermal([pose(0, np.random.default_rng(3))])
    assert fit.status == FitStatus.PARTIAL
    assert {"poly1_x", "poly1_y", "poly1_z"} <= set(fit.undetermined)
    assert not fit.model.polynomial.coefficients.any()
    assert fit.native["slopes"] == pytest.approx(OFFSET_DRIFT, abs=0.01)
    assert any("repeat it in another pose" in text for text in fit.warnings)


def test_an_axis_that_drifts_otherwise_in_another_pose_is_declined():
    rng = np.random.default_rng(4)
    fit = fit_mag_thermal([pose(0, rng), pose(1, rng, drift=OFFSET_DRIFT * [-1.0, 1.0, 1.0])])
    assert "poly1_x" in fit.undetermined
    assert any("the slope of x is" in text and "does not repeat" in text for text in fit.warnings) or any(
        "the slope of x is" in text and "its sensitivity drifts" in text for text in fit.warnings
    )


def test_recordings_are_poses_and_a_steady_temperature_is_refused():
    rng = np.random.default_rng(5)
    recordings = []
    for number in (0, 1):
        mag, t = pose(number, rng)
        warmth = Channel(Sensor.TEMPERATURE, 0, mag.t, t[:, None], "degC", Stage.RAW, "test")
        recordings.append(Recording((mag, warmth)))
    (fit,) = METHODS["mag-thermal"].run_pooled(recordings)
    assert fit.quality["poses"] == 2
    mag, t = pose(0, rng)
    assert fit_mag_thermal([(mag, np.full(len(t), 30.0))]).status == FitStatus.REFUSED


def test_a_pose_that_did_not_warm_up_is_left_out_and_named():
    rng = np.random.default_rng(6)
    mag, t = pose(0, rng)
    fit = fit_mag_thermal([pose(0, rng), pose(1, rng), (mag, 30.0 + 0.05 * (t - 35.0))])
    assert fit.quality["poses"] == 2
    assert fit.n_samples == 9000
    assert fit.n_used == 6000
    assert any(text.startswith("one pose was left out: the temperature moved by 1.2 degC") for text in fit.warnings)


def test_poses_are_pooled_by_their_precision():
    """A pose of few samples tells little: the mean is next to the other one's slope, and known no worse."""
    rng = np.random.default_rng(7)
    short = pose(1, rng)
    some = short[0].take(slice(None, None, 30)), short[1][::30]
    long = fit_mag_thermal([pose(0, np.random.default_rng(8))])
    both = fit_mag_thermal([pose(0, np.random.default_rng(8)), some])
    each = [np.array(told["slopes"]) for told in both.native["poses"]]
    sds = [np.array(told["slopes_sd"]) for told in both.native["poses"]]
    weights = [1.0 / sd**2 for sd in sds]
    mean = (weights[0] * each[0] + weights[1] * each[1]) / (weights[0] + weights[1])
    assert both.native["slopes"] == pytest.approx(mean)
    assert np.abs(mean - long.native["slopes"]).max() < np.abs(mean - each[1]).max()
    assert (np.array(both.native["slopes_sd"]) >= (weights[0] + weights[1]) ** -0.5 * 0.999).all()


def test_slopes_that_differ_widen_the_pooled_one():
    rng = np.random.default_rng(9)
    fit = fit_mag_thermal([pose(0, rng), pose(1, rng, drift=OFFSET_DRIFT * [2.0, 1.0, 1.0])])
    first, second = (np.array(told["slopes"]) for told in fit.native["poses"])
    assert fit.native["slopes_sd"][0] == pytest.approx(abs(first[0] - second[0]) / 2.0, rel=0.1)


def test_each_pose_tells_its_field_and_its_range():
    rng = np.random.default_rng(10)
    told = fit_mag_thermal([pose(0, rng), pose(1, rng)]).native["poses"]
    for number, one in enumerate(told):
        assert one["field"] == pytest.approx(POSES[number] + 10.0 * OFFSET_DRIFT, abs=0.1)  # at the mean of 35 degC
        assert (one["t_min"], one["t_max"], one["samples"]) == (
            pytest.approx(23.0),
            pytest.approx(47.0, abs=1e-3),
            3000,
        )


def test_the_reference_temperature_moves_no_slope():
    poses = [pose(0, np.random.default_rng(11)), pose(1, np.random.default_rng(12))]
    one, other = (fit_mag_thermal(poses, t_ref=t_ref) for t_ref in (25.0, -10.0))
    assert other.native["slopes"] == pytest.approx(one.native["slopes"], rel=1e-6, abs=1e-9)
    assert other.model.polynomial.t_ref == -10.0


def of(slopes, sd, field=(30.0, 30.0, 30.0)):
    """A pose with these slopes on x, y, z."""
    told = np.array(slopes, dtype=float), np.array(sd, dtype=float), np.array(field, dtype=float), np.ones(3)
    return compass._Pose(None, *told)


@pytest.mark.parametrize(
    ("slopes", "sd", "repeats"),
    [
        ((0.10, 0.10), 1e-4, True),
        ((0.10, 0.12), 1e-4, True),  # a tenth either side of their mean
        ((0.10, 0.16), 1e-4, True),  # 23 % either side
        ((0.10, 0.175), 1e-4, False),  # 27 %
        ((0.10, 0.16), 0.08, False),  # their mean is 2.3 of its own sd
        ((0.10, 0.18), 0.02, True),  # 29 %, but within 3 sd of each
        ((0.10, 0.18), 0.013, False),  # 3.1 sd
        ((0.0, 0.0), 1e-3, False),
        ((-0.10, -0.12), 1e-4, True),
    ],
)
def test_an_axis_repeats_by_agreement_sign_and_significance(slopes, sd, repeats):
    found = [of((value, 0.1, -0.1), (sd, 1e-4, 1e-4)) for value in slopes]
    assert compass._repeats(found).tolist() == [repeats, True, True]


def test_of_three_poses_every_one_has_to_repeat():
    rest = (0.1, 0.1), (1e-4, 1e-4)
    others = [of((0.2, *rest[0]), (0.08, *rest[1])), of((0.22, *rest[0]), (0.02, *rest[1]))]
    assert compass._repeats([*others, of((0.2, *rest[0]), (0.08, *rest[1]))])[0]
    assert not compass._repeats([*others, of((-0.02, *rest[0]), (0.08, *rest[1]))])[0]  # 2.8 sd off, but the other way
    assert not compass._repeats([of((0.2, *rest[0]), (0.01, *rest[1]))]).any()


@pytest.mark.parametrize(
    ("fields", "slopes", "goes"),
    [
        ((30.0, -30.0), (0.1, -0.1), True),
        ((30.0, 14.0), (0.1, 0.0467), True),
        ((30.0, 16.0), (0.1, 0.0533), False),  # fields too much alike to tell it from a drift of the offset
        ((30.0, 31.0), (0.1, 0.1033), False),
        ((30.0, -30.0), (0.1, 0.1), False),
        ((30.0, -30.0), (0.001, -0.001), False),  # within chance
    ],
)
def test_a_drift_goes_with_the_field_only_where_the_fields_differ(fields, slopes, goes):
    found = [of((k, 0.0, 0.0), (1e-3, 1e-3, 1e-3), (f, 0.0, 0.0)) for k, f in zip(slopes, fields, strict=True)]
    assert compass._goes_with_field(found, 0) == goes


def test_the_range_of_temperature_is_that_of_all_poses():
    rng = np.random.default_rng(11)
    mag, t = pose(0, rng)
    cold, warm = (mag, 0.5 * t - 10.0), (mag, t + 20.0)
    for poses in ([cold, warm], [warm, cold]):
        fit = fit_mag_thermal(poses)
        assert (fit.quality["t_min"], fit.quality["t_max"]) == (pytest.approx(1.5), pytest.approx(67.0, abs=1e-3))
