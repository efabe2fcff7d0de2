"""Recordings whose errors are known, diagnosed whole: exactly those effects and instances, and their parameters."""

from __future__ import annotations

import dataclasses
import lzma
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from scipy.spatial.transform import Rotation

from bench.gap_recordings import broad_recording
from mavcal.calib import gap, logs
from mavcal.calib.blind.real import halves, injected
from mavcal.calib.gap.schema import EffectEstimate, GapReport, GapVerdict
from mavcal.calib.recording import Channel, Recording, Sensor
from tests.unit.gap.faulted import changed, delayed, walk, white, windy_and_calm

pytestmark = [pytest.mark.shared, pytest.mark.long, pytest.mark.timeout(600)]

GAUSS = 0.1  # uT in a milligauss

FLIGHTS = {
    "bias": {
        "accel_bias": ([1], "bias", [0.3, -0.2, 0.15]),
        "gyro_bias": ([1], "bias", [0.01, -0.015, 0.008]),
        "mag_hard_iron": ([1], "hard_iron", [-6.0, 4.0, -3.0]),
    },
    "mix": {"gyro_bias": ([1], "bias", [-0.012, 0.018, 0.02]), "mag_soft_iron": ([1], "", [])},
    "vib_motor_temp": {
        "accel_vibration": ([1, 2], "amplitude", [4.0, 4.0, 4.0]),
        "accel_temp_poly": ([1], "per_degc", [8e-3, -5e-3, 12e-3]),
        "gyro_temp_linear": ([1], "per_degc", [3e-4, -2e-4, 1.5e-4]),
        "mag_motor_current": ([1, 2, 3], "per_ampere", [3.0 * GAUSS, -2.0 * GAUSS, 4.0 * GAUSS]),
    },
}
BESIDE = {"vib_motor_temp": {"gyro_vibration"}}
"""What is in the recording as well: the simulator shakes its gyroscopes too."""


def of_sensors(report: GapReport) -> list[EffectEstimate]:
    """Without what the report says of airframe and air."""
    return [e for e in report.effects if e.sensor is not None]


def agrees(effect: EffectEstimate, name: str, known: list[float]) -> None:
    for axis, value in zip("xyz", known, strict=bool(known)):
        said = next(p for p in effect.params if p.name == f"{name}.{axis}")
        assert said.value == pytest.approx(value, rel=0.1)
        assert said.se is not None
        assert abs(said.value - value) < 3.0 * max(said.se, 1e-3 * abs(value))


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight_against_the_clean_one_shows_what_was_put_in(shared_data: Path, name: str) -> None:
    folder = shared_data / "sitl_flights"
    report = gap.run(logs.read(folder / f"{name}.bin"), logs.read(folder / "null.bin"), nested=False)
    assert report.verdict is GapVerdict.EXPLAINED
    found = {e.id: e for e in of_sensors(report)}
    assert set(found) - BESIDE.get(name, set()) == set(FLIGHTS[name])
    for effect_id, (instances, parameter, known) in FLIGHTS[name].items():
        assert list(found[effect_id].instances) == instances
        assert found[effect_id].evidence.probability > 0.5
        agrees(found[effect_id], parameter, known)


def late(channel: Channel, by: float) -> NDArray[np.float64]:
    return np.column_stack([np.interp(channel.t - by, channel.t, v) for v in channel.values.T])


def slowed(channel: Channel, hz: float) -> NDArray[np.float64]:
    b, a = signal.butter(1, hz, fs=1.0 / float(np.median(np.diff(channel.t))))
    return np.asarray(signal.lfilter(b, a, channel.values - channel.values[0], axis=0) + channel.values[0])


MISALIGNED = np.array([[1.0, 0.02, -0.01], [0.0, 1.0, 0.015], [0.0, 0.0, 1.0]])
TURNED = Rotation.from_rotvec([0.07, 0.035, 0.014]).as_matrix()
SCALED = np.array([1.04, 0.97, 1.03])
MAGNET = np.array([3.0, -5.0, 4.0])
Change = tuple[Sensor, list[int], Callable[[Channel], NDArray[np.float64]]]
PUT_IN: list[dict[str, Change]] = [
    {
        "gyro_scale": (Sensor.GYRO, [1, 2], lambda c: c.values * SCALED),
        "mag_hard_iron": (Sensor.MAG, [3], lambda c: c.values + MAGNET),
    },
    {
        "accel_misalignment": (Sensor.ACCEL, [2], lambda c: c.values @ MISALIGNED.T),
        "mag_delay": (Sensor.MAG, [1, 2, 3], lambda c: late(c, 0.15)),
    },
    {"gyro_low_pass": (Sensor.GYRO, [2], lambda c: slowed(c, 12.0))},
]


@pytest.mark.parametrize("changes", PUT_IN, ids=[" ".join(c) for c in PUT_IN])
def test_what_is_put_into_a_flight_is_found_beside_its_own(shared_data: Path, changes: dict[str, Change]) -> None:
    """Put into one unit or into all: then the trajectory that is re-estimated must not take it for its own."""
    folder = shared_data / "sitl_flights"
    real = logs.read(folder / "mix.bin")
    for sensor, instances, change in changes.values():
        real = real.with_channels(
            dataclasses.replace(c, values=change(c)) if c.sensor == sensor and c.instance + 1 in instances else c
            for c in real.channels
        )
    report = gap.run(real, logs.read(folder / "null.bin"), nested=False)
    own = {"gyro_bias": [1], "mag_soft_iron": [1]}
    put = {name: instances for name, (_, instances, _) in changes.items()}
    assert {e.id: list(e.instances) for e in of_sensors(report)} == own | put
    assert not report.unknown.flag


def test_both_accelerometers_turned_alike_are_not_told_from_a_force_of_the_flight(shared_data: Path) -> None:
    folder = shared_data / "sitl_flights"
    real = logs.read(folder / "mix.bin")
    real = real.with_channels(
        dataclasses.replace(c, values=c.values @ TURNED.T) if c.sensor is Sensor.ACCEL else c for c in real.channels
    )
    report = gap.run(real, logs.read(folder / "null.bin"), nested=False)
    assert {e.id for e in of_sensors(report)} == {"gyro_bias", "mag_soft_iron"}
    assert any(warning.startswith("not a sensor's: accel_rotation") for warning in report.warnings)


def of_one_unit(recording: Recording) -> Recording:
    inertial = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG, Sensor.TEMPERATURE)
    return recording.with_channels(c for c in recording.channels if c.instance == 0 or c.sensor not in inertial)


@pytest.mark.parametrize("removed", [0.0, 0.15], ids=["all axes", "across gravity"])
def test_a_vehicle_at_rest_says_which_unit_has_a_bias_or_that_it_cannot(shared_data: Path, removed: float) -> None:
    """The attitude is levelled by the unit that has it: across gravity its tilt hides the bias."""
    whole = logs.read(shared_data / "sitl_flights" / "bias.bin")
    began = min(float(c.t[0]) for c in whole.channels)
    rest = whole.with_channels(c.between(began, began + 30.0) for c in whole.channels)
    less = np.array([0.0, 0.0, removed])
    real = rest.with_channels(
        dataclasses.replace(c, values=c.values - less) if (c.sensor, c.instance) == (Sensor.ACCEL, 0) else c
        for c in rest.channels
    )
    report = gap.run(real, logs.read(shared_data / "sitl_flights" / "null.bin"), (), nested=False)
    effect = next(e for e in report.effects if e.id == "accel_bias")
    bias = np.array([p.value for p in effect.params])
    assert np.abs(bias) == pytest.approx([0.3, 0.2, 0.15 - removed], abs=0.01)
    if removed:
        assert effect.evidence.probability <= 0.5
        assert effect.confusable_with
    else:
        assert (effect.instances, np.sign(bias).tolist()) == ((1,), [1.0, -1.0, 1.0])
        assert effect.evidence.probability > 0.9
        assert not effect.confusable_with


@pytest.mark.parametrize("name", ["mix", "vib_motor_temp"])
def test_a_vehicle_of_one_unit_shows_it_as_well(shared_data: Path, name: str) -> None:
    """With nothing to compare it with but its own trajectory, which leaves more open and says so."""
    folder = shared_data / "sitl_flights"
    real, sim = (of_one_unit(logs.read(folder / file)) for file in (f"{name}.bin", "null.bin"))
    report = gap.run(real, sim, nested=False)
    assert report.verdict is GapVerdict.EXPLAINED
    found = {e.id: e for e in of_sensors(report)}
    assert set(found) - BESIDE.get(name, set()) == set(FLIGHTS[name])
    for effect_id, (_, parameter, known) in FLIGHTS[name].items():
        if parameter in ("bias", "per_ampere"):
            agrees(found[effect_id], parameter, known)


def test_units_that_drift_alike_are_told_from_a_turn_of_the_vehicle(shared_data: Path) -> None:
    folder = shared_data / "sitl_flights"
    real = logs.read(folder / "vib_motor_temp.bin")
    warmth = real.channel(Sensor.TEMPERATURE, 0)
    slopes = {Sensor.ACCEL: [8e-3, -5e-3, 12e-3], Sensor.GYRO: [3e-4, -2e-4, 1.5e-4]}

    def warmed(c: Channel) -> Channel:
        degrees = np.interp(c.t, warmth.t, warmth.values[:, 0])
        if c.sensor is Sensor.TEMPERATURE:
            return dataclasses.replace(c, values=degrees[:, None])
        if c.sensor not in slopes or c.instance != 1:
            return c
        square = 150e-6 * (degrees - 35.0) ** 2 if c.sensor is Sensor.ACCEL else 0.0 * degrees
        drift = np.outer(degrees - 35.0, slopes[c.sensor]) + np.outer(square, [1.0, 0.0, 0.0])
        return dataclasses.replace(c, values=c.values + drift)

    report = gap.run(real.with_channels(map(warmed, real.channels)), logs.read(folder / "null.bin"), nested=False)
    found = {e.id: list(e.instances) for e in of_sensors(report)}
    assert found["gyro_temp_linear"] == found["accel_temp_poly"] == [1, 2]
    assert found["mag_motor_current"] == [1, 2, 3]
    assert set(found) == {*FLIGHTS["vib_motor_temp"], *BESIDE["vib_motor_temp"]}
    assert not report.unknown.flag


def trial(shared_data: Path, number: str) -> Recording:
    return broad_recording(next((shared_data / "broad").glob(f"{number}_*.mat")))


def beside_the_undisturbed(shared_data: Path, number: str) -> GapReport:
    return gap.run(trial(shared_data, number), None, [trial(shared_data, "01")], nested=False)


@pytest.mark.parametrize(
    ("number", "on_s", "off_s", "size"),
    [("32", (34.0, 42.0), (92.0, 100.0), [-6.0, -1.0, 58.0]), ("34", (42.0, 48.0), (94.0, 101.0), [-2.0, 0.0, 13.5])],
)
def test_a_magnet_that_is_put_on_and_taken_off_is_a_step_and_its_opposite(
    shared_data: Path, number: str, on_s: tuple[float, float], off_s: tuple[float, float], size: list[float]
) -> None:
    """Nothing else: what trial 01 shows against the cameras is no gap of the others."""
    report = beside_the_undisturbed(shared_data, number)
    assert [e.id for e in report.effects] == ["mag_step", "mag_step"]
    assert not report.unknown.flag
    assert sum(e.evidence.share for e in report.effects) == pytest.approx(1.0)
    steps = [{p.name: p.value for p in e.params} for e in report.effects]
    on, off = sorted(steps, key=lambda step: step["time_s"])
    assert on_s[0] < on["time_s"] < on_s[1]
    assert off_s[0] < off["time_s"] < off_s[1]
    for step, sign in ((on, 1.0), (off, -1.0)):
        vector = sign * np.array([step[f"step.{axis}"] for axis in "xyz"])
        assert vector == pytest.approx(size, abs=2.0)
    assert {finding.channel.partition(".")[0] for finding in report.where} == {"mag"}
    assert {name for series in report.series for name in series.parts} == {"mag_step"}
    assert any(w.startswith("two recordings differ by as much anyway") for w in report.warnings)


def test_a_weak_magnet_is_two_steps_and_handling_is_no_noise_of_the_sensor(shared_data: Path) -> None:
    """8.5 uT along z from 43 to 99 s; from 120 to 130 s somebody has the board in hand."""
    report = beside_the_undisturbed(shared_data, "35")
    assert [e.id for e in report.effects] == ["mag_step", "mag_step"]
    on, off = sorted(({p.name: p.value for p in e.params} for e in report.effects), key=lambda step: step["time_s"])
    assert on["time_s"] == pytest.approx(43.0, abs=1.5)
    assert off["time_s"] == pytest.approx(99.0, abs=1.5)
    assert on["step.z"] == pytest.approx(-8.5, abs=2.0)
    assert off["step.z"] == pytest.approx(8.5, abs=2.0)
    assert report.unknown.flag
    assert "noise on accel from 119 to 132 s" in report.unknown.shape


def packed(path: Path, folder: Path) -> Recording:
    """A log that is kept compressed."""
    plain = folder / path.stem
    plain.write_bytes(lzma.decompress(path.read_bytes()))
    return logs.read(plain)


def test_an_offset_that_px4_halves_when_it_disarms_is_an_offset(shared_data: Path, tmp_path: Path) -> None:
    real, sim = (packed(shared_data / "px4_flights" / f"{name}.ulg.xz", tmp_path) for name in ("mag_bias", "null"))
    report = gap.run(real, sim, nested=False)
    (effect,) = report.effects
    assert effect.id == "mag_hard_iron"
    agrees(effect, "hard_iron", [8.31, -5.57, 3.79])
    assert not report.unknown.flag
    assert any("changed the offset of compass 1 at 155.4 s" in warning for warning in report.warnings)


@pytest.mark.parametrize(
    ("name", "known", "sensors"),
    [
        ("d02", {"wind", "turbulence"}, {}),
        ("d08", {"inertia"}, {}),
        ("d14", {"thrust_scale"}, {"accel_scale": [1]}),
    ],
)
def test_a_vehicle_that_flies_differently_has_no_wrong_sensor(
    shared_data: Path, tmp_path: Path, name: str, known: set[str], sensors: dict[str, list[int]]
) -> None:
    """Wind and turbulence; other inertia; other thrust and a wrong accelerometer."""
    folder = shared_data / "airframe_flights"
    real, sim = (packed(folder / f"{file}.bin.xz", tmp_path) for file in (name, "d01sim"))
    report = gap.run(real, sim, nested=False)
    assert {e.id: list(e.instances) for e in of_sensors(report)} == sensors
    assert {e.id for e in report.effects} == known | set(sensors)
    assert not report.unknown.flag


def test_what_all_units_have_is_named_on_all_of_them(shared_data: Path, tmp_path: Path) -> None:
    """Gyroscopes that wander bent the trajectory: a misalignment, a scale, the Earth's field and the reference."""
    folder = shared_data / "airframe_flights"
    real, sim = (packed(folder / f"{file}.bin.xz", tmp_path) for file in ("d10", "d01sim"))
    for sensor, fault, known in (
        (Sensor.GYRO, walk(1e-3), {"gyro_random_walk": [1, 2]}),
        (Sensor.MAG, white(1.0), {"mag_noise": [1, 2, 3]}),
    ):
        report = gap.run(changed(real, sensor, fault), sim, nested=False)
        assert {e.id: list(e.instances) for e in of_sensors(report)} == known
        assert not report.unknown.flag


def test_noise_of_every_compass_hides_no_offset_of_one(shared_data: Path) -> None:
    """A difference of two flights was "jumps to and fro between two levels", in place of the offset."""
    folder = shared_data / "sitl_flights"
    real, sim = (logs.read(folder / f"{name}.bin") for name in ("bias", "null"))
    report = gap.run(changed(real, Sensor.MAG, white(1.0)), sim, nested=False)
    own = {effect_id: instances for effect_id, (instances, _, _) in FLIGHTS["bias"].items()}
    assert {e.id: list(e.instances) for e in of_sensors(report)} == own | {"mag_noise": [1, 2, 3]}
    assert not report.unknown.flag


def test_an_inertial_unit_that_was_logged_once_a_second_is_no_reference(shared_data: Path, tmp_path: Path) -> None:
    """Its attitude is off by up to 8 degrees rms from the one that the vehicle logged."""
    folder = shared_data / "airframe_flights"
    real, sim = (packed(folder / f"{file}.ulg.xz", tmp_path) for file in ("p02", "p01"))
    report = gap.run(real, sim, nested=False)
    assert of_sensors(report) == []
    assert "thrust_scale" in {e.id for e in report.effects}  # from the vehicle's own unit and attitude
    assert not report.unknown.flag
    assert 4.0 < report.inputs.att_sigma_deg < 10.0


def test_of_a_magnet_in_the_room_nothing_is_on_the_sensor(shared_data: Path) -> None:
    report = beside_the_undisturbed(shared_data, "28")
    assert report.effects == ()
    assert report.verdict is GapVerdict.UNKNOWN
    assert "mag" in report.unknown.shape


def test_tapping_is_nothing_of_the_catalogue_and_is_seen_where_it_is(shared_data: Path) -> None:
    report = beside_the_undisturbed(shared_data, "24")
    assert report.effects == ()
    assert report.verdict is GapVerdict.UNKNOWN
    assert "Hz on accel" in report.unknown.shape
    assert report.where[0].channel == "accel.z"


@pytest.mark.parametrize("second", [False, True])
def test_half_of_a_nominal_recording_beside_the_other_shows_no_gap(shared_data: Path, *, second: bool) -> None:
    first, last = halves(trial(shared_data, "01"))
    real, nominal = (last, first) if second else (first, last)
    report = gap.run(real, None, [nominal], nested=False)
    assert report.verdict is GapVerdict.NO_GAP
    assert report.where == ()


@pytest.mark.parametrize("kind", ["accel_bias", "accel_scale", "accel_step", "accel_noise", "gyro_noise", "gyro_hold"])
def test_what_is_put_into_one_of_two_units_is_found_on_that_one(shared_data: Path, kind: str) -> None:
    """Two flights of a simulator at 25 Hz: too slow for a gyroscope's own reference, so that two are held together.

    Noise is put in ten times as large: a tenth of it is called that of the rotors, or leaves something beside it.
    """
    real, sim = (logs.read(shared_data / "sitl_baseline" / f"{name}.BIN") for name in ("00000010", "00000005"))
    changed, _ = injected(real, kind, 7 if kind.endswith("noise") else 10)
    report = gap.run(changed, sim, nested=False)
    assert [(e.id, list(e.instances)) for e in report.effects] == [(kind, [1])]
    assert not report.unknown.flag
    assert report.effects[0].evidence.probability > 0.5


def test_a_gyroscope_that_is_late_is_named_although_the_trajectory_follows_it(
    shared_data: Path, tmp_path: Path
) -> None:
    real, sim = windy_and_calm(shared_data, tmp_path)
    (effect,) = of_sensors(gap.run(delayed(real, Sensor.GYRO, 0.02), sim, nested=False))
    assert (effect.id, effect.instances) == ("gyro_delay", (1,))
    assert effect.params[0].value == pytest.approx(0.02, abs=0.001)
    assert effect.params[0].ci95[0] > 0.0
