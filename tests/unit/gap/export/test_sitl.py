"""What a diagnosis writes for ArduPilot's simulator gives the effect back, in its names, units and signs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.export import patch, with_patches
from mavcal.calib.gap.export.files import sitl_text
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.schema import EffectEstimate, as_json
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate import from_sitl
from mavcal.calib.simulate.document import stated_in
from tests.examples import examples

from .making import effect, report

N = 60
DEFAULT_IRON = np.array([-0.5, -1.3, 1.8])  # uT: SIM_MAG_OFS 5, 13, -18, taken off by COMPASS_OFS
SIZE = {Sensor.ACCEL: 9.0, Sensor.GYRO: 2.0, Sensor.MAG: 45.0}


def a_trace(sensor: Sensor, seed: int = 1) -> Trace:
    rng = np.random.default_rng(seed)
    ideal = SIZE[sensor] * rng.normal(size=(N, 3))
    about = {"temperature": rng.uniform(10, 60, N), "current": rng.uniform(0, 30, N)}
    return Trace(sensor, (0,), np.arange(N) / 50.0, ideal, ideal, np.ones(N, dtype=bool), **about)


def forward(found: EffectEstimate, trace: Trace) -> np.ndarray:
    """What the catalogue says that an effect adds."""
    described = by_id()[found.id]
    assert isinstance(described, MeanEffect)
    values = np.array([p.value for p in found.params])
    theta = values[-1] if described.shape is not None else np.nan
    if described.exact is not None:
        return described.exact(trace, values)
    columns = described.columns(trace, theta)
    return np.einsum("p,pni->ni", values[: len(columns)], columns)


def simulated(values: dict[str, float], trace: Trace) -> np.ndarray:
    """What the simulator's sensor reads, its present offsets taken off again."""
    errors = from_sitl(values).suite.by_sensor[trace.sensor]
    ahead = np.zeros((N, 3))
    if trace.sensor is Sensor.MAG:
        motor = np.array([values.get(f"SIM_MAG_MOT_{a}", 0.0) for a in "XYZ"])
        ahead = 0.1 * motor * trace.current[:, None]
    before = DEFAULT_IRON if trace.sensor is Sensor.MAG else 0.0
    return errors.systematic(trace.ideal + ahead, trace.temperature) - before


MIXES = {
    "accelerometer": (
        effect("accel_bias", bias=(0.3, -0.2, 0.15)),
        effect("accel_scale", scale=(0.02, -0.01, 0.03)),
        effect(
            "accel_temp_poly",
            per_degc=(0.008, -0.005, 0.012),
            per_degc2=(1e-4, 0, -2e-5),
            per_degc3=(-2e-6, 3e-6, 0),
            t_ref=21.0,
        ),
    ),
    "gyroscope": (
        effect("gyro_bias", bias=(0.01, -0.015, 0.008)),
        effect("gyro_scale", scale=(0.03, -0.02, 0.04)),
        effect("gyro_temp_linear", per_degc=(3e-4, -2e-4, 1.5e-4), t_ref=25.0),
    ),
    "compass": (
        effect("mag_hard_iron", hard_iron=(-6.0, 4.0, -3.0)),
        effect("mag_soft_iron", soft_iron={"xx": 0.05, "yy": -0.07, "zz": 0.1, "xy": 0.04, "xz": -0.05, "yz": 0.06}),
        effect("mag_motor_current", per_ampere=(0.3, -0.2, 0.4)),
    ),
}


@pytest.mark.parametrize("name", MIXES)
def test_the_simulator_then_reads_the_sum_of_the_effects(name: str) -> None:
    effects = MIXES[name]
    trace = a_trace(effects[0].sensor)
    found = patch(report(*effects))
    assert found.not_held == ()
    expected = trace.ideal + sum(forward(e, trace) for e in effects)
    np.testing.assert_allclose(simulated(dict(found.values), trace), expected, atol=2e-9 * SIZE[trace.sensor])


@pytest.mark.parametrize("one", [e for mix in MIXES.values() for e in mix], ids=lambda e: e.id)
def test_each_effect_alone_has_its_own_patch(one: EffectEstimate) -> None:
    trace = a_trace(one.sensor)
    whole = with_patches(report(one, *(e for e in MIXES["accelerometer"] if e.sensor is not one.sensor)))
    values = as_json(whole)["effects"][0]["sim_patch"]
    if one.id == "mag_motor_current":  # alone it does not speak of the offsets that are there
        values = {"SIM_MAG1_OFS_X": 5.0, "SIM_MAG1_OFS_Y": 13.0, "SIM_MAG1_OFS_Z": -18.0, **values}
    if one.id == "mag_soft_iron":
        values = {"SIM_MAG1_OFS_X": 5.0, "SIM_MAG1_OFS_Y": 13.0, "SIM_MAG1_OFS_Z": -18.0, **values}
    np.testing.assert_allclose(
        simulated(values, trace), trace.ideal + forward(one, trace), atol=2e-9 * SIZE[trace.sensor]
    )


def test_literal_numbers_of_the_simulator() -> None:
    """The cases of the reference flights, in SITL's units and signs."""
    found = patch(
        report(
            effect("accel_bias", bias=(0.3, -0.2, 0.15)),
            effect("mag_hard_iron", hard_iron=(-6.0, 4.0, -3.0)),
            effect("mag_motor_current", (1, 2, 3), per_ampere=(0.3, -0.2, 0.4)),
            effect("accel_vibration", (1, 2), amplitude=(4.0, 4.0, 4.0), frequency_hz=87.0),
            effect("mag_delay", (1, 2, 3), delay_s=0.0151),
        )
    ).values
    assert found["SIM_ACC1_BIAS_X"] == pytest.approx(0.3)
    assert found["SIM_MAG1_OFS_X"] == pytest.approx(5.0 + 60.0)
    assert found["SIM_MAG1_OFS_Y"] == pytest.approx(13.0 - 40.0)
    assert [found[f"SIM_MAG_MOT_{a}"] for a in "XYZ"] == pytest.approx([3.0, -2.0, 4.0])
    assert [found[f"SIM_VIB_FREQ_{a}"] for a in "XYZ"] == [87.0] * 3
    assert found["SIM_ACC1_RND"] == found["SIM_ACC2_RND"] == pytest.approx(4.0)
    assert found["SIM_MAG_DELAY"] == 15.0


def test_a_drift_is_stated_about_the_middle_of_the_simulators_range() -> None:
    poly = effect("accel_temp_poly", per_degc=(0.0065, 0, 0), per_degc2=(1.5e-4, 0, 0), t_ref=30.0)
    values = patch(report(poly)).values
    assert (values["SIM_IMUT1_TMIN"], values["SIM_IMUT1_TMAX"]) == (0.0, 70.0)
    assert values["SIM_IMUT1_ACC1_X"] == pytest.approx((0.0065 + 2 * 1.5e-4 * 5.0) * 1e6)
    assert values["SIM_IMUT1_ACC2_X"] == pytest.approx(150.0)
    assert values["SIM_ACC1_BIAS_X"] == pytest.approx(0.0065 * 5.0 + 1.5e-4 * 25.0)
    assert not any("GYR" in name for name in values)


@pytest.mark.parametrize(
    ("base", "middle"),
    [
        ({"SIM_IMUT1_TMIN": 10.0, "SIM_IMUT1_TMAX": 50.0}, 30.0),
        ({"SIM_IMUT1_TMIN": -20.0, "SIM_IMUT1_TMAX": 100.0}, 40.0),
        ({"SIM_IMUT1_TMIN": 10.0, "SIM_ACC1_BIAS_X": 0.0}, 40.0),  # the simulator's own TMAX is 70
        ({"SIM_IMUT1_TMAX": 50.0, "SIM_ACC1_BIAS_X": 0.0}, 25.0),  # and its TMIN 0
    ],
)
def test_a_drift_is_the_effects_at_every_temperature_of_the_simulators_range(
    base: dict[str, float], middle: float
) -> None:
    poly = effect("accel_temp_poly", per_degc=(0.0065, 0, 0), per_degc2=(1.5e-4, 0, 0), t_ref=30.0)
    values = patch(report(poly), base).values
    assert 0.5 * (values["SIM_IMUT1_TMIN"] + values["SIM_IMUT1_TMAX"]) == pytest.approx(middle)
    for temperature in (0.0, 25.0, 60.0):
        d, e = temperature - middle, temperature - 30.0
        drift = sum(1e-6 * values[f"SIM_IMUT1_ACC{k}_X"] * d**k for k in (1, 2, 3))
        assert values["SIM_ACC1_BIAS_X"] + drift == pytest.approx(0.0065 * e + 1.5e-4 * e**2)


def test_what_the_simulator_has_stays_below_the_effect_and_keeps_its_names() -> None:
    base = {"SIM_MAG_OFS_X": 7.0, "SIM_MAG_OFS_Y": 0.0, "SIM_MAG_OFS_Z": 1.0, "SIM_MAG_MOT_X": 2.0}
    base["SIM_ACC1_BIAS_X"] = 0.1
    effects = (
        effect("mag_hard_iron", (1, 2), hard_iron=(1.0, 0.0, 0.0)),
        effect("accel_bias", bias=(0.3, 0.0, 0.0)),
        effect("mag_motor_current", (1, 2), per_ampere=(0.1, 0.0, 0.0)),
    )
    values = patch(report(*effects), base).values
    assert values["SIM_MAG_OFS_X"] == pytest.approx(-3.0)
    assert values["SIM_MAG2_OFS_X"] == pytest.approx(-10.0)
    assert values["SIM_ACC1_BIAS_X"] == pytest.approx(0.4)
    assert values["SIM_MAG_MOT_X"] == pytest.approx(3.0)
    assert "SIM_MAG1_OFS_X" not in values


@pytest.mark.parametrize(
    ("one", "word"),
    [
        (effect("gyro_g_sensitivity"), "no parameter"),
        (effect("accel_misalignment", misalignment={"xy": 0.01}), "cross terms"),
        (effect("accel_random_walk", random_walk=(1e-3,) * 3), "uniform"),
        (effect("reference_attitude", rotation=(0.01, 0, 0)), "reference"),
        (effect("accel_bias", (9,), bias=(1, 0, 0)), "5 instances"),
        (effect("accel_vibration", amplitude=(4.0, 4.0, 0.5), frequency_hz=80.0), "one amplitude"),
        (effect("mag_delay", delay_s=-0.01), "ahead"),
        (effect("accel_scale", scale=(-1.5, 0, 0)), "positive"),
    ],
    ids=lambda v: v if isinstance(v, str) else v.id,
)
def test_what_cannot_be_held_is_said_by_name(one: EffectEstimate, word: str) -> None:
    found = patch(report(one))
    assert len(found.not_held) == 1
    assert one.id in found.not_held[0]
    assert word in found.not_held[0]


def test_a_wave_that_follows_a_rotor_is_written_with_its_size_or_said_by_name() -> None:
    whole = effect("accel_vibration", cos=(3.0, 3.0, 3.0), sin=(4.0, 4.0, 4.0), rotor_order=101.0)
    wave = dataclasses.replace(whole, params=tuple(p for p in whole.params if p.value))
    found = patch(report(wave))
    assert found.not_held or found.values["SIM_ACC1_RND"] == pytest.approx(5.0)


def test_a_motor_field_on_one_compass_of_three_is_not_only_there() -> None:
    others = effect("mag_hard_iron", (2, 3), hard_iron=(1, 0, 0))
    found = patch(report(effect("mag_motor_current", (1,), per_ampere=(1, 0, 0)), others))
    assert any("mag_motor_current" in text and "2, 3" in text for text in found.not_held)


def test_two_effects_do_not_share_one_parameter_silently() -> None:
    one = effect("accel_vibration", (1,), amplitude=(4, 4, 4), frequency_hz=87.0)
    two = effect("accel_tone", (2,), cos=(1, 1, 1), frequency_hz=50.0)
    found = patch(report(one, two))
    assert found.values["SIM_VIB_FREQ_X"] == 87.0
    assert any("already used" in text for text in found.not_held)


def test_the_file_reads_back_as_the_sensors(tmp_path: object) -> None:
    text = sitl_text(patch(report(*MIXES["accelerometer"], effect("gyro_g_sensitivity"))))
    assert "# not held: gyro_g_sensitivity" in text
    errors = stated_in(text, ".parm").suite.accel
    np.testing.assert_allclose(np.diag(errors.matrix) - 1.0, [0.02, -0.01, 0.03], rtol=1e-5)


@settings(max_examples=examples(30), deadline=None)
@given(st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6), st.lists(st.floats(-20, 20), min_size=3, max_size=3))
def test_any_soft_and_hard_iron_comes_back(iron: list[float], hard: list[float]) -> None:
    names = ("xx", "yy", "zz", "xy", "xz", "yz")
    effects = (
        effect("mag_hard_iron", hard_iron=tuple(hard)),
        effect("mag_soft_iron", soft_iron=dict(zip(names, iron, strict=True))),
    )
    trace = a_trace(Sensor.MAG)
    expected = trace.ideal + sum(forward(e, trace) for e in effects)
    np.testing.assert_allclose(simulated(dict(patch(report(*effects)).values), trace), expected, atol=1e-7)


def test_a_field_that_follows_the_throttle_is_not_held() -> None:
    by_current = effect("mag_motor_current", (1,), per_ampere=(3.0, -2.0, 4.0))
    renamed = [dataclasses.replace(p, name=p.name.replace("per_ampere", "full_throttle")) for p in by_current.params]
    found = patch(report(dataclasses.replace(by_current, params=tuple(renamed))))
    assert not any(name.startswith("SIM_MAG_MOT") for name in found.values)
    assert any("throttle" in text for text in found.not_held)
