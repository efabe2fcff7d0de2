"""Gazebo's SDF and MATLAB's script: literal numbers, axes, units, and what they cannot hold."""

from __future__ import annotations

import dataclasses
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.gap.export import ENDINGS, Target, exported, target_of
from mavcal.calib.gap.schema import GapVerdict
from mavcal.calib.recording import Recording

from .making import effect, report

EFFECTS = (
    effect("accel_bias", bias=(0.3, -0.2, 0.15)),
    effect("gyro_noise", density=(1e-4, 2e-4, 3e-4)),
    effect("gyro_random_walk", random_walk=(1e-5, 0, 0)),
    effect("mag_hard_iron", hard_iron=(-6.0, 4.0, -3.0)),
    effect("gyro_delay", delay_s=0.01),
    effect("accel_bias", (2,), bias=(1.0, 0.0, 0.0)),
)


def test_gazebo_has_its_own_axes_and_units() -> None:
    made = exported(report(*EFFECTS), Recording(()), Target.GAZEBO)
    root = ElementTree.fromstring(f"<all>{made.text}</all>")

    def noise(group: str, key: str) -> list[float]:
        return [float(root.findtext(f".//{group}/{axis}/noise/{key}") or "nan") for axis in "xyz"]

    assert noise("linear_acceleration", "mean") == pytest.approx([0.3, 0.2, -0.15])
    assert noise("magnetometer", "mean") == pytest.approx([-6e-6, -4e-6, 3e-6])
    assert noise("angular_velocity", "stddev") == pytest.approx(np.array([1e-4, 2e-4, 3e-4]) * np.sqrt(250.0))
    assert noise("angular_velocity", "dynamic_bias_stddev")[0] == pytest.approx(1e-5 * np.sqrt(500.0))
    assert [text.split(":")[0] for text in made.not_held] == ["gyro_delay of instance 1", "accel_bias of instance 2"]


def test_matlab_reads_gravity_less_acceleration() -> None:
    made = exported(report(*EFFECTS), Recording(()), Target.MATLAB)
    values = dict(re.findall(r"^(\w+\.\w+) = (.*);$", made.text, flags=re.MULTILINE))
    assert values["accel.ConstantBias"] == "[-0.3 0.2 -0.15]"
    assert values["gyro.NoiseDensity"] == "[0.0001 0.0002 0.0003]"
    assert values["mag.ConstantBias"] == "[-6 4 -3]"
    assert values["imu.Magnetometer"] == "mag"
    assert "% not held: gyro_delay of instance 1" in made.text


def test_our_own_document_is_of_one_instance() -> None:
    second = exported(report(*EFFECTS), Recording(()), Target.MAVCAL, instance=2)
    assert json.loads(second.text)["accel"]["bias"] == [1.0, 0.0, 0.0]
    assert set(json.loads(second.text)) == {"accel"}
    assert len(second.not_held) == 5


def test_a_lag_behind_the_thermometer_is_said_to_be_of_first_order() -> None:
    lag = effect("accel_thermal_lag", per_degc=(0.01, 0, 0), lag_s=20.0)
    made = exported(report(lag), Recording(()), Target.MAVCAL)
    assert json.loads(made.text)["accel"]["thermal_lag"] == -20.0
    assert "first order" in made.not_held[0]


@pytest.mark.parametrize("suffix", ENDINGS)
def test_endings_say_whom_a_file_is_for(suffix: str) -> None:
    assert target_of(f"folder/x{suffix}") is ENDINGS[suffix]


def test_nothing_is_exported_where_nothing_was_found() -> None:
    bare = report()
    assert bare.verdict is GapVerdict.NO_GAP
    for target in Target:
        with pytest.raises(ValueError, match="there is no gap"):
            exported(bare, Recording(()), target)
    with pytest.raises(ValueError, match="--for"):
        target_of("x.txt")


@pytest.mark.parametrize("target", [Target.SITL, Target.GAZEBO, Target.MATLAB, Target.MAVCAL])
def test_an_effect_that_is_less_likely_than_something_else_is_told_beside_the_file(target: Target) -> None:
    bias = effect("accel_bias", bias=(0.3, -0.2, 0.15))
    guess = dataclasses.replace(bias, evidence=dataclasses.replace(bias.evidence, probability=0.21))
    made = exported(report(guess), Recording(()), target)
    assert made.doubtful == ("accel_bias of instance 1: it has a probability of 0.21: something else is likelier",)
    assert ("0.21" in made.text) is (target is Target.SITL)
    assert exported(report(bias), Recording(()), target).doubtful == ()
