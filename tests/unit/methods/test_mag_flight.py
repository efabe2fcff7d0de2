"""A compass from a flight as the command line asks for it: attitude, place, year, drive, where the flight ends."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.mag.flights import Truth, fly

PLACE = (47.4, 8.55, 500.0)
UTC = Event(0.0, "utc", "2024-07-01T12:00:00+00:00")


@pytest.fixture(scope="module")
def flight():
    return fly(Truth(duration=40.0, heading_error=0.03), np.random.default_rng(31))


def recorded(flight, *more, without=(), **facts):
    """The flight as a log, `without` some of its sensors, with `more` channels."""
    channels = [flight.mag, flight.turning.gyro, flight.turning.attitude, flight.current, flight.throttle]
    return Recording((*(c for c in channels if c.sensor not in without), *more), **facts)


def position(*rows):
    values = np.array(rows, dtype=float)
    return Channel(Sensor.POSITION, 0, np.arange(len(values)) * 1.0, values, "deg", Stage.RAW, "made")


def run(recording, method="mag-flight", **options):
    (fit,) = METHODS[method].run(recording, {"soft_iron": "held", **options} if method == "mag-flight" else options)
    return fit


def test_the_attitude_that_is_asked_for_must_be_there(flight):
    with pytest.raises(InvalidInputError, match="the recording has no attitude: use the gyroscope alone, --attitude g"):
        run(recorded(flight, without={Sensor.ATTITUDE}), attitude="log")
    with pytest.raises(InvalidInputError, match="no gyroscope in rad/s: use the log's attitude, --attitude log"):
        run(recorded(flight, without={Sensor.GYRO}), attitude="gyro")
    nothing = run(recorded(flight, without={Sensor.GYRO, Sensor.ATTITUDE}))
    assert nothing.message.startswith("nothing says how the vehicle turned")


@pytest.mark.parametrize(
    ("attitude", "sources"), [("log", ["attitude"]), ("gyro", ["gyro"]), ("auto", ["gyro", "attitude"])]
)
def test_the_motion_comes_from_what_is_asked_for(flight, attitude, sources):
    fit = run(recorded(flight), attitude=attitude, drive="none")
    assert fit.native["from"] == sources
    assert not fit.native["without_motors"]


def test_a_strength_of_the_field_serves_the_gyroscope_alone(flight):
    for strength in (0.0, -50.0):
        with pytest.raises(InvalidInputError, match="the strength of the field is positive, not"):
            run(recorded(flight), field=strength)
    with pytest.raises(InvalidInputError, match="a strength of the field without its dip needs --attitude gyro"):
        run(recorded(flight), field=50.0)
    fit = run(recorded(flight), field=50.0, attitude="gyro", drive="none")
    assert fit.native["field_strength"] == pytest.approx(50.0, rel=0.02)
    assert not any("field strength unknown" in text for text in fit.warnings)


@pytest.mark.parametrize(
    ("rows", "events", "options", "known"),
    [
        ([PLACE], (UTC,), {}, True),
        ([PLACE], (), {"year": 2024.5}, True),
        ([PLACE], (), {}, False),  # nobody says when
        ([(0.0, 0.0, 0.0)] * 3, (UTC,), {}, False),  # a receiver without a fix
        ([(0.0, 0.0, 0.0), PLACE, PLACE], (UTC,), {}, True),
    ],
)
def test_place_and_time_of_a_flight_tell_its_field(flight, rows, events, options, known):
    fit = run(recorded(flight, position(*rows), events=events), attitude="gyro", drive="none", **options)
    assert any("field strength unknown" in text for text in fit.warnings) is not known
    assert (fit.quality["field_ratio"] is not None) is known


def test_the_year_that_is_stated_goes_before_the_clock_of_the_log(flight):
    log = recorded(flight, position(PLACE), events=(UTC,))
    with pytest.raises(InvalidInputError, match=r"no magnetic model for the year 1990\.0"):
        run(log, year=1990.0)
    late = run(log, attitude="gyro", drive="none", year=2031.0)
    assert any("outside the years of" in text for text in late.warnings)


def test_a_drive_that_is_asked_for_must_change(flight):
    with pytest.raises(InvalidInputError, match="the recording has no throttle that changes"):
        run(recorded(flight, without={Sensor.THROTTLE}), drive="throttle")
    flat = Channel(Sensor.CURRENT, 0, flight.current.t, np.full((400, 1), 5.0), "A", Stage.RAW, "made")
    with pytest.raises(InvalidInputError, match="the recording has no current that changes"):
        run(recorded(flight, flat, without={Sensor.CURRENT}), drive="current")


def test_without_any_drive_no_motors_are_found(flight):
    bare = recorded(flight, without={Sensor.CURRENT, Sensor.THROTTLE})
    assert run(bare, "mag-motor").status == FitStatus.REFUSED
    assert not run(bare).native["without_motors"]


def test_corrupt_parameters_are_named_before_anything_is_fitted(flight):
    corrupt = recorded(
        flight,
        parameters=ParameterTimeline.constant({"COMPASS_MOT_X": float("nan"), "COMPASS_MOTCT": 2.0}),
        identity=Identity(autopilot="ardupilot"),
    )
    for method in ("mag-flight", "mag-motor"):
        fit = run(corrupt, method)
        assert fit.status == FitStatus.REFUSED
        assert "COMPASS_MOT_X = nan" in fit.message
        assert fit.quality["corrupt_parameters"] is True
    assert set(run(corrupt).movements.values()) == {"put the parameters right, then fly again"}


def crashed(flight, at=25.0):
    t = np.arange(0.0, 40.0, 0.1)
    force = np.tile([0.0, 0.0, -9.8], (len(t), 1))
    force[int(at * 10)] = [0.0, 0.0, -90.0]
    upside = np.where((t >= at)[:, None], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    accel = Channel(Sensor.ACCEL, 0, t, force, "m/s2", Stage.RAW, "made")
    said = Channel(Sensor.ATTITUDE, 0, t, upside, "1", Stage.RAW, "made")
    return recorded(flight, accel, said, without={Sensor.ATTITUDE})


def test_nothing_after_a_crash_is_used_unless_it_is_asked_for(flight):
    fit = run(crashed(flight), attitude="gyro", drive="none")
    assert "nothing after 23.0 s was used: a crash. --until uses more" in fit.warnings
    assert fit.n_used <= 231
    longer = run(crashed(flight), attitude="gyro", drive="none", until=39.9)
    assert not any("a crash" in text for text in longer.warnings)
    assert longer.n_used > 350


def test_the_gyroscope_with_the_most_samples_serves_unless_one_is_asked_for(flight):
    gyro = flight.turning.gyro
    wrong = Channel(Sensor.GYRO, 1, gyro.t[::2], np.full((len(gyro) // 2, 3), 40.0), "rad/s", Stage.RAW, "made")
    both = recorded(flight, wrong)
    assert run(both, attitude="gyro", drive="none").status != FitStatus.REFUSED
    fit = run(both, attitude="gyro", drive="none", gyro=1)
    assert "half of the time: its unit is another" in fit.message
