"""Whole reports of flights: what is the vehicle's, what is a sensor's and what is of the day."""

from __future__ import annotations

import lzma
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib import gap, logs
from mavcal.calib.airframe.answer import Domain
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.schema import GapReport, GapVerdict
from mavcal.calib.recording import Recording, Sensor
from tests.unit.airframe.flights import flight

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return flight(tmp_path_factory.mktemp("simulated") / "x.bin")


def told(report: GapReport) -> dict[str, tuple[Domain, tuple[int, ...]]]:
    return {e.id: (e.domain, e.instances) for e in report.effects}


WIND = {"SIM_WIND_SPD": 2.0, "SIM_WIND_DIR": 200.0}
CASES: dict[str, tuple[Mapping[str, Any], Mapping[str, float], GapVerdict, dict[str, tuple[Domain, tuple[int, ...]]]]]
CASES = {
    "another day": ({}, WIND, GapVerdict.NO_GAP, {"wind": (Domain.ENVIRONMENT, ())}),
    "a weak motor": (
        {}, {"SIM_ENGINE_FAIL": 4.0, "SIM_ENGINE_MUL": 0.96}, GapVerdict.EXPLAINED,
        {"motor_weak": (Domain.AIRFRAME, (3,))},
    ),
    "a gyroscope": (
        {}, {f"SIM_GYR1_SCALE_{a}": 3.0 for a in "XYZ"}, GapVerdict.EXPLAINED, {"gyro_scale": (Domain.SENSOR, (1,))}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(CASES))
def test_each_effect_is_told_of_where_it_sits(tmp_path: Path, simulated: Recording, name: str) -> None:
    frame, parameters, verdict, known = CASES[name]
    report = gap.run(flight(tmp_path / "x.bin", frame, other=True, **parameters), simulated, nested=False)
    assert told(report) == known
    assert report.verdict is verdict
    assert not report.unknown.flag
    assert report.airframe is not None


def muted(recording: Recording) -> Recording:
    """The recording as if its log had no outputs of the motors, nor what its controller asks for."""
    channels = [c for c in recording.channels if c.sensor != Sensor.MOTOR]
    dynamics = tuple(c for c in recording.dynamics if c.sensor not in {Sensor.CONTROL, Sensor.MIXER})
    return replace(recording.with_channels(channels), dynamics=dynamics)


@pytest.mark.parametrize("which", ["real", "simulated"])
def test_a_flight_without_outputs_is_not_held_for_one_with_the_same_airframe(
    tmp_path: Path, simulated: Recording, which: str
) -> None:
    weak = flight(tmp_path / "x.bin", other=True, SIM_ENGINE_FAIL=4.0, SIM_ENGINE_MUL=0.9)
    pair = (muted(weak), simulated) if which == "real" else (weak, muted(simulated))
    report = gap.run(*pair, pace=GapPace(lambda: 1.0, limit_s=0.1))
    (untested,) = (n for n in report.not_testable if n.id == "airframe")
    assert untested.reason == f"{which} recording: no commands of the motors are logged"
    assert "LOG_BITMASK" in untested.need


def test_turbulence_of_a_flight_alone_is_no_noise_of_its_sensors(tmp_path: Path) -> None:
    """Both units feel it alike, and not at rest."""
    report = gap.run(flight(tmp_path / "x.bin", SIM_WIND_SPD=6.0, SIM_WIND_TURB=1.0), nested=False)
    assert not [e.id for e in report.effects if e.id.startswith(("accel_", "gyro_"))]
    (untested,) = (n for n in report.not_testable if n.id == "airframe")
    assert "--sim" in untested.need
    assert report.airframe is not None


def packed(folder: Path, name: str, to: Path) -> Recording:
    plain = to / name
    plain.write_bytes(lzma.decompress((folder / f"{name}.xz").read_bytes()))
    return logs.read(plain)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "verdict", "sensors", "of_air"),
    [
        ("f02", GapVerdict.NO_GAP, {}, {"wind", "turbulence"}),
        ("f10", GapVerdict.EXPLAINED, {"gyro_rotor_noise": (1, 2)}, set()),
    ],
)
def test_turbulence_is_no_sensors_and_noise_of_gyroscopes_is_no_air(
    shared_data: Path, tmp_path: Path, name: str, verdict: GapVerdict, sensors: dict, of_air: set
) -> None:
    """Wind of 8 m/s with turbulence, and a day without wind on which both gyroscopes are noisy."""
    folder = shared_data / "sitl_flights_2"
    real, sim = (packed(folder, f"{one}.bin", tmp_path) for one in (name, "f01sim"))
    report = gap.run(real, sim, nested=False)
    assert {e.id: e.instances for e in report.effects if e.domain is Domain.SENSOR} == sensors
    assert {e.id for e in report.effects if e.domain is Domain.ENVIRONMENT} == of_air
    assert {e.id for e in report.effects if e.domain is Domain.AIRFRAME} == set()
    assert report.verdict is verdict
    assert not report.unknown.flag
