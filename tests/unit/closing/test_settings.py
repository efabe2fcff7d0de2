"""Patches add up over rounds, and the files say what they hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence
from mavcal.service.closing.errors import WrongCommand
from mavcal.service.closing.settings import LOGGING, SimSettings, read_settings

EVIDENCE = EffectEvidence(100.0, 1, 1e-6, 0.99, 1.0)


def effect(**patch: Any) -> EffectEstimate:
    return EffectEstimate("x", None, (), (), EVIDENCE, sim_patch=patch, domain=Domain.AIRFRAME)


def test_a_patch_is_absolute_and_the_last_one_of_a_name_holds() -> None:
    start = SimSettings({"SIM_WIND_SPD": 1.0}, {"mass": 2.0})
    once = start.patched([effect(SIM_ENGINE_MUL=0.96, frame_json={"hoverThrOut": 0.41})])
    twice = once.patched([effect(frame_json={"hoverThrOut": 0.4, "propExpo": 0.5}), effect(sdf={"x": 1})])
    assert twice.parameters == {"SIM_WIND_SPD": 1.0, "SIM_ENGINE_MUL": 0.96}
    assert twice.frame == {"mass": 2.0, "hoverThrOut": 0.4, "propExpo": 0.5}
    assert twice.changed_from(once) == {"hoverThrOut": (0.41, 0.4), "propExpo": (None, 0.5)}
    assert start == SimSettings({"SIM_WIND_SPD": 1.0}, {"mass": 2.0})


def test_the_files_can_be_read_again(tmp_path: Path) -> None:
    settings = SimSettings({"SIM_ENGINE_MUL": 0.9612345678, "LOG_BITMASK": 5.0}, {"motor1_position": [0.1, 0.2, 0.0]})
    files = tmp_path / "sim.parm", tmp_path / "frame.json"
    settings.write(*files)
    assert json.loads(files[1].read_text()) == settings.frame
    again = read_settings(files[0], None)
    assert again.parameters == {**LOGGING, "LOG_BITMASK": 5.0, "SIM_ENGINE_MUL": pytest.approx(0.9612345678, rel=1e-8)}


def test_nothing_given_is_nothing_set(tmp_path: Path) -> None:
    assert read_settings(None, None) == SimSettings()
    SimSettings().write(tmp_path / "p", tmp_path / "f")
    assert json.loads((tmp_path / "f").read_text()) == {}


def test_files_of_the_user_may_have_comments(tmp_path: Path) -> None:
    parameters = tmp_path / "a.parm"
    parameters.write_text("# mine\nSIM_WIND_SPD,3 # m/s\n")
    assert read_settings(parameters, {"mass": 2.5}) == SimSettings({"SIM_WIND_SPD": 3.0}, {"mass": 2.5})


def test_a_line_that_is_no_parameter_is_refused(tmp_path: Path) -> None:
    (tmp_path / "p").write_text("SIM_WIND_SPD")
    with pytest.raises(WrongCommand, match=r"line 1.*NAME VALUE"):
        read_settings(tmp_path / "p", None)
