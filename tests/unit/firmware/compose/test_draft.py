"""A plan in the making keeps what it is told, in the order of writing."""

from __future__ import annotations

import pytest

from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import Fingerprint, Loss, ParameterKind
from mavcal.calib.recording import Sensor

GYRO = Subject(Sensor.GYRO, 1)
NAMES = ("INS_GYR2OFFS_X", "INS_GYR2OFFS_Y", "INS_GYR2OFFS_Z")
HELD = dict.fromkeys(NAMES, 0.0) | {"INS_GYR_ID": 5, "INS_USE": 1}
WHOSE = Fingerprint("ardupilot", "", "4.6", ())


@pytest.fixture
def draft():
    return Draft(HELD, ComposeOptions(), ParameterKind.INT32)


def real(draft, name, value, rank=Rank.OFFSET, about=GYRO, **more):
    draft.set_real(name, value, rank, "why", about=about, **more)


def integer(draft, name, value, rank=Rank.ID, **more):
    draft.set_integer(name, value, rank, "why", kind=ParameterKind.INT32, **more)


def test_ranks_come_first_and_then_the_order_of_telling(draft):
    integer(draft, "INS_GYR_ID", 7, about=GYRO)
    for name in (NAMES[2], NAMES[0], NAMES[1]):
        real(draft, name, 0.0625)
    integer(draft, "INS_USE", 0, Rank.SESSION)
    assert [c.name for c in draft.changes] == ["INS_USE", NAMES[2], NAMES[0], NAMES[1], "INS_GYR_ID"]
    draft.reorder(NAMES)
    assert [c.name for c in draft.changes] == ["INS_USE", *NAMES, "INS_GYR_ID"]
    assert draft.ranks(GYRO) == {Rank.OFFSET, Rank.ID}
    assert draft.ranks(Subject(Sensor.GYRO, 0)) == set()
    assert [c.name for c in draft.planned(["X", NAMES[1]])] == [NAMES[1]]


def test_the_order_of_the_ranks_is_the_safe_one():
    order = "SESSION TEMPERATURE THERMAL THERMAL_ENABLE ROTATION OFFSET CROSS SCALE FIELD_SCALE LEVEL SETTING ID"
    assert [rank.name for rank in sorted(Rank)] == order.split()


def test_a_change_knows_whose_it_is_and_of_nobody_it_is_the_vehicle_s(draft):
    real(draft, NAMES[0], 0.1, sd=0.02, unit="rad/s", needs_reboot=True)
    integer(draft, "INS_GYR_ID", 7, about=GYRO, session=True, needs_reboot=True)
    integer(draft, "INS_USE", 0)
    real(draft, NAMES[1], 0.2, about=None)
    offset, owner, use, nobody = (draft.planned([n])[0] for n in (NAMES[0], "INS_GYR_ID", "INS_USE", NAMES[1]))
    assert (offset.old, offset.new, offset.sd, offset.unit) == (0.0, 0.10000000149011612, 0.02, "rad/s")
    assert [(c.sensor, c.instance) for c in (offset, owner)] == [(Sensor.GYRO, 1)] * 2
    assert [(c.sensor, c.instance) for c in (use, nobody)] == [(None, 0)] * 2
    assert [(c.needs_reboot, c.session) for c in (offset, owner, use)] == [(True, False), (True, True), (False, False)]
    assert (owner.old, owner.new, owner.kind) == (5, 7, ParameterKind.INT32)


def test_a_value_that_is_held_already_is_no_change_and_takes_an_earlier_one_back(draft):
    real(draft, NAMES[0], 0.0625)
    assert draft.get(NAMES[0], 9.0) == 0.0625
    real(draft, NAMES[0], 1e-60)  # zero in single precision
    integer(draft, "INS_USE", 0)
    integer(draft, "INS_USE", 1)
    assert draft.changes == ()
    assert (draft.get(NAMES[0], 9.0), draft.get("NOT_THERE", 9.0)) == (0.0, 9.0)
    real(draft, NAMES[1], 0.03125)
    assert draft.predicted == HELD | {NAMES[1]: 0.03125}


def test_a_change_that_was_taken_back_leaves_its_place_to_the_next(draft):
    for name, value in ((NAMES[0], 0.0625), (NAMES[1], 0.0625), (NAMES[0], 0.0), (NAMES[2], 0.0625)):
        real(draft, name, value)
    assert [c.name for c in draft.changes] == [NAMES[1], NAMES[2]]


def test_a_name_that_is_not_listed_refuses_its_sensor_unless_it_is_hidden(draft):
    real(draft, "INS4_GYROFFS_X", 0.0625)
    integer(draft, "INS4_GYR_ID", 5, about=GYRO)
    assert draft.changes == ()
    assert [text.split(",")[0] for text in draft.refused[GYRO]] == [
        "the vehicle does not list INS4_GYROFFS_X",
        "the vehicle does not list INS4_GYR_ID",
    ]
    real(draft, "INS_TCAL1_GYR1_X", 0.0625, hidden=True)
    integer(draft, "INS_TCAL1_ENABLE", 1, hidden=True)
    assert [(c.name, c.old) for c in draft.changes] == [("INS_TCAL1_GYR1_X", None), ("INS_TCAL1_ENABLE", None)]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -3.5e38])
def test_what_is_no_single_precision_number_refuses_its_sensor(draft, value):
    real(draft, NAMES[0], value)
    assert draft.changes == ()
    assert f"{NAMES[0]} would be {value}: not a finite number" in draft.refused[GYRO][0]
    real(draft, NAMES[1], 0.1)
    assert len(draft.changes) == 1


def test_a_number_that_could_not_be_put_back_is_not_overwritten():
    draft = Draft(HELD | {NAMES[0]: float("nan")}, ComposeOptions(), ParameterKind.INT32)
    real(draft, NAMES[0], 0.1)
    assert draft.changes == ()
    assert "could not be put back" in draft.refused[GYRO][0]


def test_settings_of_the_session_alone_are_no_plan(draft):
    integer(draft, "INS_USE", 0, Rank.SESSION, session=True)
    assert draft.changes == ()
    real(draft, NAMES[0], 0.0625)
    assert [c.session for c in draft.changes] == [True, False]


def test_everything_is_said_once_and_the_first_first(draft):
    for text in ("a", "b", "a"):
        draft.warn(text)
    draft.warn("c", first=True)
    draft.warn("b", first=True)
    draft.block("whole")
    draft.block("whole")
    draft.block("own", GYRO)
    draft.block("own", GYRO)
    draft.drop(GYRO, "first")
    draft.drop(GYRO, "second")
    draft.lose(GYRO, "scale", 2, "rad/s", "text")
    draft.losses_of([Loss(Sensor.GYRO, 1, "scale", 2.0, "rad/s", "text"), Loss(Sensor.ACCEL, 0, "a", 1.0, "m/s2", "b")])
    draft.after(42, (1.0, 0, 0, 0, 0, 0, 7.0), "store")
    plan = draft.plan(WHOSE)
    assert plan.warnings == ("c", "a", "b")
    assert plan.blockers == ("whole", "own")
    assert draft.refused == {GYRO: ("own",)}
    assert draft.dropped == {GYRO: "first"}
    assert [(loss.sensor, loss.instance, loss.cost) for loss in plan.losses] == [
        (Sensor.GYRO, 1, 2.0),
        (Sensor.ACCEL, 0, 1.0),
    ]
    assert [(a.command, a.params[6], a.why) for a in plan.after] == [(42, 7.0, "store")]
    assert (plan.fingerprint, plan.agreements, str(GYRO)) == (WHOSE, (), "gyro 2")
