from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.earth import EarthField
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.procedures.fixed_yaw import SPEC, MagFixedYawProcedure
from mavcal.calib.procedures.protocol import Done, GaveUp
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Identity

from .conftest import attitude

FIELD = EarthField([20.5, 1.2, 44.0], norm_sd=0.15)
CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0}, earth_field=FIELD)


def run(recording, context=CONTEXT, **options):
    procedure = MagFixedYawProcedure(SPEC.validated({"heading": 70.0, **options}), context)
    procedure.feed(recording)
    procedure.end()
    return procedure


@pytest.fixture
def standing(bench):
    """A vehicle at heading 70 deg, slightly tilted, with ideal accelerometers and compasses without soft iron."""

    def make(seconds=10.0, *, move=False, **fields):
        accel = replace(bench().accels[0], offset=(0.0, 0.0, 0.0), sensitivity=np.eye(3))
        mag = replace(bench().mags[0], sensitivity=np.eye(3))
        made = bench(accels=(accel,), mags=(mag,), **fields)
        return (made.tumble(seconds) if move else made.hold(seconds, attitude(3.0, -2.0, 70.0))).record()

    return make


def test_one_rest_at_a_known_heading_gives_the_offset(standing, bench):
    outcome = run(standing(14.0)).outcome
    assert isinstance(outcome, Done), outcome
    (fit,) = outcome.results
    error = fit.model.offset - np.array(bench().mags[0].offset)
    assert (np.abs(error) < 3.0 * np.sqrt(np.diag(fit.covariance)[:3])).all()
    assert np.linalg.norm(error) < 0.5
    assert "the heading is known to 2.0 deg as it stands" in outcome.because


def test_the_heading_is_required(standing):
    with pytest.raises(InvalidInputError, match="heading of the nose from true north"):
        SPEC.validated({})


def test_without_a_place_it_ends_at_once(standing):
    outcome = run(standing(), replace(CONTEXT, earth_field=None)).outcome
    assert isinstance(outcome, GaveUp)
    assert "position is not known" in outcome.cause


def test_a_vehicle_that_moves_or_an_accelerometer_that_is_off_gives_nothing(standing, bench):
    moved = run(standing(30.0, move=True), patience=15.0).outcome
    assert isinstance(moved, GaveUp)
    assert "no rest" in moved.cause
    off = bench(accels=(replace(bench().accels[0], offset=(0.0, 0.0, 0.6), sensitivity=np.eye(3)),))
    wrong = run(off.hold(10.0, attitude(0.0, 0.0, 70.0)).record()).outcome
    assert isinstance(wrong, GaveUp)
    assert "is not calibrated" in wrong.cause
