from __future__ import annotations

import ast
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import OFFSETS, FitBuilder, FitResult, FitStatus, parameter_names
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.triad import TriadModel

ROOT = Path(__file__).resolve().parents[2]
MADE = FitBuilder("m", Sensor.GYRO, 1, "rad/s", 40, relative=True, temperature=21.0, movement="turn it")


def fitted(**more: object) -> FitResult:
    told = {"message": "said", "n_used": 38, "residual_rms": 0.1, "condition_number": 2.0, **more}
    return MADE.fitted(TriadModel(), np.zeros((12, 12)), **told)  # type: ignore[arg-type]


def test_what_is_known_beforehand_is_in_the_fit():
    fit = fitted(warnings=(w for w in ("a", "b")))
    assert (fit.method, fit.sensor, fit.instance, fit.unit) == ("m", Sensor.GYRO, 1, "rad/s")
    assert (fit.n_samples, fit.n_used, fit.relative, fit.temperature) == (40, 38, True, 21.0)
    assert (fit.status, fit.undetermined, fit.movements, fit.warnings) == (FitStatus.OK, (), {}, ("a", "b"))


def test_what_is_open_makes_it_partial_unless_the_method_never_promised_it():
    open_names = {"offset_x": "rest it", "offset_y": ""}
    fit = fitted(undetermined=open_names)
    assert (fit.status, fit.undetermined, fit.movements) == (
        FitStatus.PARTIAL,
        tuple(open_names),
        {"offset_x": "rest it"},
    )
    assert fitted(undetermined=open_names, partial=False).status == FitStatus.OK


def test_a_refusal_tells_the_movement_of_the_method_or_a_better_one():
    fit = MADE.refused("no", OFFSETS)
    assert (fit.status, fit.n_used, fit.movements) == (FitStatus.REFUSED, 0, dict.fromkeys(OFFSETS, "turn it"))
    assert MADE.refused("no", OFFSETS, "shake it").movements["offset_x"] == "shake it"
    silent = dataclasses.replace(MADE, movement="").refused("no")
    assert (silent.undetermined, silent.movements) == (parameter_names(), {})


def test_the_samples_may_be_those_of_a_channel():
    channel = Channel(Sensor.MAG, 2, np.arange(5.0), np.zeros((5, 3)), "uT", Stage.RAW, "test")
    assert FitBuilder.of("m", channel) == FitBuilder("m", Sensor.MAG, 2, "uT", 5)


def test_what_does_not_fit_together_is_never_built():
    with pytest.raises(InvalidInputError, match="no parameter"):
        fitted(undetermined={"offset_q": "rest it"})


def makers() -> set[str]:
    """Modules that call ``FitResult`` themselves."""
    found = set()
    for path in (ROOT / "calib").rglob("*.py"):
        calls = [n.func for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
        if any(isinstance(f, ast.Name) and f.id == "FitResult" for f in calls):
            found.add(path.relative_to(ROOT).as_posix())
    return found


@pytest.mark.long
def test_every_fit_comes_from_the_builder_or_from_its_json():
    assert makers() == {"calib/fit.py"}  # the reader of JSON is cattrs
