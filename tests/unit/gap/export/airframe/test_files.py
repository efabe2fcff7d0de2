"""The airframe's remedy as files: each is read back, and says what it cannot hold."""

from __future__ import annotations

import dataclasses
import re
from typing import Any
from xml.etree import ElementTree

import pytest

from mavcal.calib.airframe.answer import AirframePart
from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.export import ParameterFormat
from mavcal.calib.gap.export import Target, exported, frame_from_text, target_of, with_patches
from mavcal.calib.gap.export.airframe.belief import belief_changes
from mavcal.calib.gap.schema import EffectEstimate, GapReport, as_json
from mavcal.calib.recording import Identity, ParameterEntry, ParameterTimeline, Recording
from tests.parameter_files import read_parameters
from tests.unit.gap.export.making import PLUS, airframe, effect, report

EFFECTS = (
    airframe("thrust_scale", s=0.9, sim=25.0),
    airframe("rotor_drag", c1=1.6, sim=0.25),
    airframe("motor_weak", motor=3, s=0.92),
    airframe("actuator_delay", delay=0.01),
    airframe("wind", north=3.0),
    effect("accel_bias", bias=(0.3, 0.0, -0.1)),
)


BARE = Recording(())


def found(*effects: EffectEstimate) -> GapReport:
    return dataclasses.replace(report(*effects), airframe=AirframePart(geometry=PLUS))


def written(target: Target, *effects: EffectEstimate, real: Recording = BARE, **how: Any) -> tuple[str, list[str]]:
    made = exported(found(*(effects or EFFECTS)), real, target, **how)
    return made.text, list(made.not_held)


def beginnings(lost: list[str]) -> list[str]:
    return [text.split(":")[0] for text in lost]


def test_sitl_has_its_parameters_in_one_file_and_its_frame_in_another() -> None:
    text, lost = written(Target.SITL)
    values = read_parameters(text, ParameterFormat.PARM)
    assert values["SIM_ENGINE_FAIL"] == 4
    assert values["SIM_ACC1_BIAS_X"] == pytest.approx(0.3)
    assert beginnings(lost) == ["actuator_delay", "motor_weak of motor 3", "mdrag_coef, refSpd, hoverThrOut", "wind"]
    assert lost[2].endswith("in the frame's file (--for sitl, .json)")
    text, lost = written(Target.FRAME)
    keys = frame_from_text(text)
    assert set(keys) == {"hoverThrOut", "mdrag_coef", "refSpd"}
    assert keys["hoverThrOut"] == pytest.approx(0.433333, abs=1e-6)
    assert "SIM_ENGINE_FAIL, SIM_ENGINE_MUL: in the parameter file" in " ".join(lost)
    assert "accel_bias of instance 1" in beginnings(lost)
    assert all("wind" in said for said in (lost[-1], text))


def test_the_frame_that_flew_is_kept_and_changed() -> None:
    keys = {"mass": 1.5, "diagonal_size": 0.5, "hoverThrOut": 0.3, "motor1_vector": [0, 0, -1]}
    text, _ = written(Target.FRAME, EFFECTS[0], frame=keys)
    assert frame_from_text(text) == {**keys, "hoverThrOut": pytest.approx(0.3 / 0.9)}
    assert "stock frame" not in text
    assert "stock frame" in written(Target.FRAME, EFFECTS[0])[0]
    heavy, _ = written(Target.FRAME, EFFECTS[0], frame=keys, mass=2.0)
    assert frame_from_text(heavy)["mass"] == 2.0


def test_comments_of_a_frame_are_no_keys() -> None:
    assert frame_from_text('# a {frame}\n{ "mass" : 2, # kg\n "num_motors": 4 }') == {"mass": 2, "num_motors": 4}
    for wrong in ("{", "[1]", ""):
        with pytest.raises(ValueError, match="JSON"):
            frame_from_text(wrong)


@pytest.mark.parametrize("keys", [{"mass": "3"}, {"mass": 0}, {"refSpd": float("inf")}, {"moment_inertia": [1, 2]}])
def test_a_frame_that_no_simulator_takes_is_refused(keys: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="of the simulator's frame"):
        written(Target.FRAME, EFFECTS[0], frame=keys)


def test_sih_is_a_file_of_qgroundcontrol() -> None:
    text, lost = written(Target.SIH, base={"SIH_T_MAX": 6.0})
    assert read_parameters(text, ParameterFormat.PARAMS) == pytest.approx(
        {"SIH_T_MAX": 5.4, "SIH_Q_MAX": 0.09, "SIH_KDV": 1.6}
    )
    assert beginnings(lost) == ["motor_weak of motor 3", "actuator_delay", "accel_bias of instance 1", "wind"]
    assert read_parameters(written(Target.SIH)[0], ParameterFormat.PARAMS)["SIH_T_MAX"] == 4.5


def test_gazebo_says_what_to_multiply() -> None:
    text, lost = written(
        Target.GAZEBO,
        *EFFECTS,
        airframe("motor_lag", tau_up=0.03, tau_down=-0.05),
        airframe("inertia", x=1.25, xy=0.1, yz=-0.2),
        airframe("cg_offset", x=0.05, y=-0.02),
        airframe("yaw_coefficient", s=1.2),
        mass=2.0,
    )
    root = ElementTree.fromstring(f"<all>{text}</all>")
    first, weak = root.findall("plugin")
    value = {e.tag: float(e.text or "nan") for e in first}
    assert value["motorConstant"] == pytest.approx(0.9 * 8.54858e-06, rel=1e-5)
    assert value["momentConstant"] == pytest.approx(0.016 * 1.2)
    assert value["rotorDragCoefficient"] == pytest.approx(1e-4 * 1.6 * 0.9**0.5, rel=1e-5)  # slower rotors drag less
    assert (value["timeConstantUp"], value["timeConstantDown"]) == (0.0425, 0.0)
    assert weak.findtext("motorNumber") == "2"
    assert float(weak.findtext("motorConstant") or "nan") == pytest.approx(0.9 * 0.92 * 8.54858e-06, rel=1e-5)
    assert root.findtext("inertial/mass") == "2"
    assert "<!-- inertia: ixx times 1.25, iyy times 1, izz times 1 -->" in text
    assert "<!-- inertia: ixy -0.1 times iyy to the model's own -->" in text  # forward-left-up
    assert "<!-- inertia: iyz -0.2 times izz" in text
    assert "<!-- pose: x +0.05, y +0.02 times the longest arm" in text
    assert beginnings(lost) == ["actuator_delay", "motor_lag", "wind"]
    assert root.find("sensor") is not None


def test_matlab_has_a_struct_of_the_real_airframe() -> None:
    text, lost = written(
        Target.MATLAB,
        *EFFECTS,
        airframe("inertia", x=1.25, xz=0.1, sim=287.0),
        airframe("motor_lag", tau_up=0.02, sim=0.03),
        mass=2.0,
    )
    values = dict(re.findall(r"^(airframe[.\w]*) = (.*?);", text, flags=re.MULTILINE))
    assert values["airframe"] == "struct('m', 2)"
    assert (values["airframe.k"], values["airframe.ratio.k"]) == ("[22.5]", "[0.9]")
    assert (values["airframe.I"], values["airframe.ratio.I"]) == ("[]", "[1.25 1 1]")
    assert values["airframe.difference.I_p"] == "[0 0.1 0]"
    assert values["airframe.difference.delay"] == "[0.01]"
    assert (values["airframe.tau"], values["airframe.difference.tau"]) == ("[0.05 0.05]", "[0.02 0.02]")
    assert values["airframe.c2"] == "[]"
    assert "motor_weak of motor 3" in beginnings(lost)
    assert "accel = accelparams;" in text


def test_mavcal_simulates_no_airframe() -> None:
    assert beginnings(written(Target.MAVCAL)[1])[:2] == ["thrust_scale", "rotor_drag"]


def test_a_target_that_is_stated_goes_before_the_ending() -> None:
    assert target_of("a.json", "sitl") is Target.FRAME
    assert target_of("a.parm", "sitl") is Target.SITL
    assert target_of("a.json") is Target.MAVCAL
    assert target_of("a.params") is Target.SIH
    assert target_of("a.params", "vehicle") is Target.VEHICLE


def test_nothing_is_exported_of_the_air_or_for_want_of_an_airframe() -> None:
    with pytest.raises(ValueError, match="only the air differs"):
        written(Target.SITL, airframe("wind", north=3.0))
    for target in (Target.FRAME, Target.SIH):
        with pytest.raises(ValueError, match="no effect of the airframe"):
            written(target, EFFECTS[-1])


def test_a_report_carries_each_effects_own_settings() -> None:
    patched = with_patches(found(*EFFECTS), {"SIM_BATT_VOLTAGE": 12.6})
    said = {e["id"]: e["sim_patch"] for e in as_json(patched)["effects"]}
    assert said["thrust_scale"] == {"frame_json": {"hoverThrOut": pytest.approx(0.4333333)}}
    assert set(said["rotor_drag"]["frame_json"]) == {"mdrag_coef", "refSpd"}
    assert set(said["motor_weak"]) == {"SIM_ENGINE_FAIL", "SIM_ENGINE_MUL"}
    assert said["wind"] == said["actuator_delay"] == {}
    assert set(said["accel_bias"]) == {f"SIM_ACC1_BIAS_{a}" for a in "XYZ"}
    heavy = with_patches(found(*EFFECTS), {"SIM_BATT_VOLTAGE": 12.6}, mass=4.5)
    parts = [e.sim_patch for e in heavy.effects if "frame_json" in e.sim_patch]
    assert {part["frame_json"]["mass"] for part in parts} == {4.5}
    assert heavy.effects[0].sim_patch["frame_json"]["refCurrent"] == pytest.approx(29.3 * 1.5)
    in_px4 = with_patches(found(*EFFECTS), {"SIH_KDV": 2.0})
    assert in_px4.effects[1].sim_patch == {"SIH_KDV": pytest.approx(3.2)}


ARDUPILOT = {"MOT_THST_EXPO": 0.65, "MOT_THST_HOVER": 0.39, "EK3_DRAG_MCOEF": 0.2}
ARDUPILOT |= {"EK3_DRAG_BCOEF_X": 20.0, "EK3_DRAG_BCOEF_Y": 20.0}
PX4 = {"THR_MDL_FAC": 0.0, "MPC_THR_HOVER": 0.5, "EKF2_DRAG_CTRL": 1, "EKF2_MCOEF": 0.15}
PX4 |= {"EKF2_BCOEF_X": 100.0, "EKF2_BCOEF_Y": 100.0}
BELIEVED = (
    airframe("thrust_scale", s=0.9, sim=25.0),
    airframe("thrust_expo", expo=-0.17, sim=0.65),
    airframe("rotor_drag", c1=1.6, sim=0.25),
    airframe("body_drag", c2=1.7, sim=0.03),
    airframe("inertia", x=1.2, sim=280.0),
)


def test_what_a_firmware_believes_is_set_to_the_real_values() -> None:
    changes, left = belief_changes(BELIEVED, "ardupilot", ARDUPILOT)
    new = {c.name: c.new for c in changes}
    expected = {"MOT_THST_HOVER": 9.80665 / 22.5, "MOT_THST_EXPO": 0.48, "EK3_DRAG_MCOEF": 0.4}
    expected |= dict.fromkeys(("EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y"), 1.225 / (2.0 * 0.051))
    assert new == pytest.approx(expected, rel=1e-6)
    assert [text.split(":")[0] for text in left] == ["inertia"]
    changes, _ = belief_changes(BELIEVED, "px4", PX4)
    assert {c.name for c in changes} == {"THR_MDL_FAC", "MPC_THR_HOVER", "EKF2_MCOEF", "EKF2_BCOEF_X", "EKF2_BCOEF_Y"}


def test_what_a_firmware_does_not_use_or_has_already_is_left() -> None:
    unused = ARDUPILOT | dict.fromkeys(("EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y"), 0.0)
    changes, left = belief_changes(BELIEVED[2:4], "ardupilot", unused)
    assert changes == ()
    assert all("uses no drag" in text for text in left)
    changes, left = belief_changes(BELIEVED[1:2], "ardupilot", {"MOT_THST_EXPO": 0.4801})
    assert (changes, left) == ((), ("thrust_expo: MOT_THST_EXPO is 0.4801 already",))
    assert "the log has no MOT_THST_EXPO" in belief_changes(BELIEVED[1:2], "ardupilot", {})[1][0]
    assert "not known" in belief_changes((airframe("rotor_drag", c1=1.6),), "ardupilot", ARDUPILOT)[1][0]
    evidence = dataclasses.replace(BELIEVED[0].evidence, probability=0.4)
    changes, left = belief_changes((dataclasses.replace(BELIEVED[0], evidence=evidence),), "ardupilot", ARDUPILOT)
    assert changes == ()
    assert "something else is likelier" in left[0]


def test_a_vehicles_file_holds_its_beliefs_and_says_when_to_load_them() -> None:
    entries = tuple(ParameterEntry(0.0, name, value) for name, value in ARDUPILOT.items())
    timeline = ParameterTimeline(entries, end_observed=True)
    real = Recording((), parameters=timeline, identity=Identity("ardupilot", 2, (4, 7, 0), "0123"))
    text, lost = written(Target.VEHICLE, *BELIEVED, EFFECTS[4], real=real, form=ParameterFormat.PARAM)
    assert read_parameters(text, ParameterFormat.PARAM)["MOT_THST_EXPO"] == pytest.approx(0.48)
    assert "while disarmed only" in text
    assert beginnings(lost) == ["inertia", "wind"]
    with pytest.raises(FirmwareError, match="inertia"):
        written(Target.VEHICLE, BELIEVED[-1], real=real)
