"""Where motors sit: facts of ArduPilot's and PX4's sources (AIRFRAME 3.1, 3.2)."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.airframe.answer import Geometry
from mavcal.calib.airframe.geometry import NAMED, arms, geometry_of, mixer_factors

FRONT, REAR, LEFT, RIGHT = 1.0, -1.0, -1.0, 1.0
CCW, CW = 1, -1


def of(parameters: dict, frame: str | None = None) -> Geometry:
    found = geometry_of(parameters, frame)
    assert found is not None
    return found


@pytest.mark.parametrize("name", sorted(NAMED))
def test_every_frame_is_balanced(name: str) -> None:
    """A hover needs equal commands: places and directions add up to nothing, and no factor is above a half."""
    geometry = of({}, name)
    x, y, spin = arms(geometry.motors)
    assert [np.abs(way.sum()) < 1e-5 for way in (x, y, spin)] == [True] * 3
    assert set(spin) == {1.0, -1.0}
    np.testing.assert_allclose(np.hypot(x, y), 1.0, atol=1e-5)
    assert len({(round(a, 3), round(b, 3)) for a, b in zip(x, y, strict=True)}) == len(x) in (4, 6, 8)
    factors = mixer_factors(geometry)
    np.testing.assert_allclose(factors.sum(axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(np.abs(factors).max(axis=0), 0.5)
    np.testing.assert_allclose(factors.T @ factors, np.diag(np.diag(factors.T @ factors)), atol=1e-5)


@pytest.mark.parametrize("name", sorted(NAMED))
def test_a_stated_frame_is_that_of_its_parameters(name: str) -> None:
    frame_class, frame_type = NAMED[name]
    told = of({"FRAME_CLASS": frame_class, "FRAME_TYPE": frame_type})
    assert told.motors == of({}, name).motors
    assert (told.source, of({}, name).source) == ("parameters", "user")
    assert name == f"{told.frame_class}-{told.frame_type}".replace(" ", "-")


def test_motors_of_the_quad_x_are_numbered_as_ardupilot_does() -> None:
    """1 front right, 2 rear left (both counter-clockwise), 3 front left, 4 rear right (both clockwise)."""
    motors = of({"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}).motors
    assert [(np.sign(m.x), np.sign(m.y), m.spin) for m in motors] == [
        (FRONT, RIGHT, CCW), (REAR, LEFT, CCW), (FRONT, LEFT, CW), (REAR, RIGHT, CW),
    ]  # fmt: skip
    assert {round(abs(m.x), 4) for m in motors} == {0.7071}


def test_motors_of_the_quad_plus_are_numbered_as_ardupilot_does() -> None:
    motors = of({"FRAME_CLASS": 1.0, "FRAME_TYPE": 0.0}).motors
    assert [(m.x, m.y, m.spin) for m in motors] == [(0, 1, CCW), (0, -1, CCW), (1, 0, CW), (-1, 0, CW)]


def test_motors_of_the_quad_h_turn_against_those_of_the_quad_x() -> None:
    """``AP_MotorsMatrix.cpp``: "H frame set-up - same as X but motors spin in opposite directions"."""
    x, h = (of({"FRAME_CLASS": 1.0, "FRAME_TYPE": kind}).motors for kind in (1.0, 3.0))
    assert [(m.x, m.y, -m.spin) for m in h] == [(m.x, m.y, m.spin) for m in x]


def test_hexa_and_octa_begin_where_ardupilot_begins() -> None:
    hexa, octa = (of({"FRAME_CLASS": kind, "FRAME_TYPE": 1.0}).motors for kind in (2.0, 3.0))
    assert (hexa[0].x, hexa[0].y, hexa[0].spin) == (0.0, 1.0, CW)
    assert (hexa[4].x, hexa[4].y, hexa[4].spin) == (pytest.approx(0.866, abs=1e-3), pytest.approx(0.5), CCW)
    assert np.degrees(np.arctan2(octa[0].y, octa[0].x)) == pytest.approx(22.5, abs=1e-3)
    assert np.degrees(np.arctan2(octa[6].y, octa[6].x)) == pytest.approx(-67.5, abs=1e-3)
    assert (octa[0].spin, octa[6].spin) == (CW, CW)


def test_factors_of_the_mixer_are_ardupilots() -> None:
    """rf = cos(angle + 90) / 2, pf = cos(angle) / 2, each by its largest; yf 1/2 for counter-clockwise."""
    for name, degrees in (("quad-x", (45, -135, -45, 135)), ("quad-plus", (90, -90, 0, 180))):
        angle = np.radians(degrees)
        known = np.column_stack([np.cos(angle + np.pi / 2), np.cos(angle), [1, 1, -1, -1]])
        np.testing.assert_allclose(mixer_factors(of({}, name)), 0.5 * known / np.abs(known).max(axis=0), atol=1e-6)


def test_an_old_log_tells_its_frame_by_one_parameter() -> None:
    assert of({"FRAME": 1.0}).motors == of({}, "quad-x").motors
    assert of({"FRAME": 0.0}).motors == of({}, "quad-plus").motors
    assert geometry_of({"FRAME": 2.0}) is None  # V: other yaw factors


def rotors(places: list[tuple[float, float]], spins: str, **more: float) -> dict[str, float]:
    found: dict[str, float] = {"CA_ROTOR_COUNT": len(places), "CA_AIRFRAME": 0}
    for n, ((x, y), spin) in enumerate(zip(places, spins, strict=True)):
        found |= {f"CA_ROTOR{n}_PX": x, f"CA_ROTOR{n}_PY": y, f"CA_ROTOR{n}_KM": 0.05 if spin == "+" else -0.05}
    return found | more


SIH = [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)]
HEXA = [(np.cos(a), np.sin(a)) for a in np.radians([90, -90, -30, 150, 30, -150])]


@pytest.mark.parametrize("size", [1.0, 0.13, 40.0])
def test_rotors_of_px4_are_in_arms_whatever_their_unit_is(size: float) -> None:
    """Stock SIH has places of +-1: they are no metres. KM above 0 turns counter-clockwise."""
    geometry = of(rotors([(size * x, size * y) for x, y in SIH], "++--"))
    assert geometry.motors == of({}, "quad-x").motors
    assert (geometry.frame_class, geometry.source) == ("quad", "parameters")


def test_six_rotors_are_a_hexa() -> None:
    geometry = of(rotors(HEXA, "-+-++-"))
    assert geometry.frame_class == "hexa"
    for a, b in zip(geometry.motors, of({}, "hexa-x").motors, strict=True):
        assert (a.x, a.y, a.spin) == (pytest.approx(b.x, abs=2e-6), pytest.approx(b.y, abs=2e-6), b.spin)


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"FRAME_CLASS": 7.0, "FRAME_TYPE": 1.0},  # tricopter
        {"FRAME_CLASS": 4.0, "FRAME_TYPE": 1.0},  # coaxial
        {"FRAME_CLASS": 1.0, "FRAME_TYPE": 2.0},  # V
        {"FRAME_CLASS": 1.0, "FRAME_TYPE": 4.0},  # V tail
        rotors(SIH, "++--", CA_ROTOR2_AX=0.2),
        rotors(SIH, "++--", CA_ROTOR0_AY=-0.1),
        rotors(SIH, "++--", CA_ROTOR1_PX=0.0, CA_ROTOR1_PY=0.0),
        rotors(SIH, "++--", CA_AIRFRAME=2.0),  # a tiltrotor
        rotors(SIH[:3], "+-+"),
        rotors([*HEXA, *SIH], "++--++--+-"),
    ],
)
def test_what_has_no_model_here_has_no_geometry(parameters: dict[str, float]) -> None:
    assert geometry_of(parameters) is None


def test_a_frame_that_nobody_knows_is_none_and_not_another() -> None:
    assert geometry_of({"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}, "quad-y") is None
    assert of({"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}, "hexa-x").frame_class == "hexa"
