"""Flights of real firmware whose airframe differs by a known effect: each label is found, and nothing beside it."""

from __future__ import annotations

import lzma
from functools import cache
from pathlib import Path

import pytest

from mavcal.calib import logs
from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.diagnose import airframe_gap
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect
from mavcal.calib.recording import Recording

pytestmark = [pytest.mark.shared, pytest.mark.long, pytest.mark.timeout(300)]

Known = dict[str, dict[str, float]]
RATIOS: dict[str, Known] = {
    "d04.bin": {"thrust_scale": {"s": 0.9}},
    "d06.bin": {"rotor_drag": {"c1": 1.6}},
    "d07.bin": {"body_drag": {"c2": 1.7}},
    "d08.bin": {"inertia": {"x": 1.25, "y": 1.25}},
    "d09.bin": {"inertia": {"z": 0.75}},
    "d11.bin": {"motor_weak 3": {"s": 0.9207}},
    "d13.bin": {"rotor_drag": {"c1": 0.6}, "motor_weak 1": {"s": 0.9403}},
    "d14.bin": {"thrust_scale": {"s": 1.08}},
    "p02.ulg": {"thrust_scale": {"s": 0.9}},
    "p03.ulg": {"rotor_drag": {"c1": 0.6}},
}
"""Real by simulated: ``labels.json``."""
DIFFERENCES: dict[str, Known] = {
    "d05.bin": {"thrust_expo": {"expo": -0.17}},
    "d10.bin": {"cg_offset": {"x": 0.012 / 0.35, "y": -0.007 / 0.35}},
    "d12.bin": {"battery_sag": {"exponent": 2.0}},
    "d15.bin": {"motor_lag": {"slew": 1.2}},
    "p04.ulg": {"motor_lag": {"tau_up": 0.04}},
}
NULLS = {
    "airframe_flights/d01.bin": None,
    "airframe_flights/d02.bin": (-1.087, -4.057),  # 4.2 m/s from 75 degrees
    "sitl_flights_2/f02.bin": None,  # 8 m/s at 60 m, less below
    "sitl_flights_2/f10.bin": None,  # noise of both gyroscopes
}
SIMULATED = {"d": "airframe_flights/d01sim.bin", "p": "airframe_flights/p01.ulg", "f": "sitl_flights_2/f01sim.bin"}


@cache
def read(folder: Path, name: str, to: Path) -> Recording:
    """A log that is kept compressed."""
    packed = folder / f"{name}.xz"
    if not packed.exists():
        pytest.skip(f"no {name} in the shared data")
    plain = to / Path(name).name
    plain.write_bytes(lzma.decompress(packed.read_bytes()))
    recording = logs.read(plain)
    plain.unlink()
    return recording


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@cache
def diagnosed(shared_data: Path, name: str, room: Path) -> AirframeAnswer:
    real, sim = (read(shared_data, one, room) for one in (name, SIMULATED[Path(name).name[0]]))
    answer = airframe_gap(real, sim)
    assert isinstance(answer, AirframeAnswer), answer
    return answer


def of_airframe(answer: AirframeAnswer) -> dict[str, FoundEffect]:
    """By id, and by number where it is a motor's."""
    return {
        " ".join([f.id, *map(str, f.motors)]): f for f in answer.found if f.domain is Domain.AIRFRAME
    }  # fmt: skip


@pytest.mark.parametrize("name", sorted({**RATIOS, **DIFFERENCES}))
def test_what_a_flight_was_given_is_found(shared_data: Path, room: Path, name: str) -> None:
    """Ratios to 5 % or two standard errors of it; differences to a tenth or two standard errors."""
    answer = diagnosed(shared_data, f"airframe_flights/{name}", room)
    found, known = of_airframe(answer), {**RATIOS, **DIFFERENCES}[name]
    assert set(found) == set(known)
    for id_, sizes in known.items():
        assert found[id_].probability > 0.9
        values = {v.name: v for v in found[id_].values}
        for parameter, size in sizes.items():
            one = values[parameter]
            assert one.relative is (name in RATIOS)
            if one.relative:
                assert 1.0 + one.value == pytest.approx(size, abs=max(0.05 * size, 2.0 * one.sd))
            else:
                assert one.value == pytest.approx(size, abs=max(0.1 * abs(size), 2.0 * one.sd))


@pytest.mark.parametrize("name", sorted({**RATIOS, **DIFFERENCES}))
def test_what_a_flight_was_given_leaves_nothing_without_a_name(shared_data: Path, room: Path, name: str) -> None:
    answer = diagnosed(shared_data, f"airframe_flights/{name}", room)
    assert (answer.unknown, answer.unknown_share) == ("", 0.0)
    assert answer.nameless < 0.5


@pytest.mark.parametrize("name", sorted(NULLS))
def test_a_flight_on_a_windy_day_has_no_other_airframe(shared_data: Path, room: Path, name: str) -> None:
    answer = diagnosed(shared_data, name, room)
    assert of_airframe(answer) == {}
    assert answer.unknown == ""
    wind = NULLS[name]
    if wind is not None:
        assert answer.part.wind == pytest.approx(wind, abs=0.3)


def test_a_vehicle_against_itself_shows_nothing(shared_data: Path, room: Path) -> None:
    one = read(shared_data, "airframe_flights/d01sim.bin", room)
    answer = airframe_gap(one, one)
    assert isinstance(answer, AirframeAnswer)
    assert answer.found == ()
    assert answer.nameless < 0.1


@pytest.mark.parametrize("name", ["d04.bin", "d10.bin", "d11.bin"])
def test_the_first_half_minute_of_a_flight_names_nothing_that_it_did_not_fly(
    shared_data: Path, room: Path, name: str
) -> None:
    """Doublets in roll alone: an inertia in pitch of 1.75 was beside the thrust of d04."""
    packed = shared_data / f"airframe_flights/{name}.xz"
    if not packed.exists():
        pytest.skip(f"no {name} in the shared data")
    part = room / f"first-{name}"
    with lzma.open(packed) as whole:
        part.write_bytes(whole.read(3_000_000))
    answer = airframe_gap(logs.read(part), read(shared_data, SIMULATED["d"], room))
    assert isinstance(answer, AirframeAnswer)
    assert set(of_airframe(answer)) == set({**RATIOS, **DIFFERENCES}[name])
    assert not answer.unknown
