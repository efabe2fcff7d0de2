"""The campaign's judge finds what is wrong: a campaign whose judge is blind shows nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.campaign.judge import Ending, Evidence, OwnWrite, Stop, doubt_complaints, held_back, judge, stop_complaints
from bench.campaign.scenario import KINDS, scenarios
from bench.campaign.truth import Holding, Residual, residuals
from mavcal.service.simvehicle import SimulatedVehicle

OLD = {"A": 0.0, "B": 1.0, "C": 5.0, "SESSION": 1.0, "STAT_RUNTIME": 7.0}
CHANGES = [
    {"name": "SESSION", "old": 1.0, "new": 0.0, "session": True},
    {"name": "A", "old": 0.0, "new": 0.1, "session": False},
    {"name": "B", "old": 1.0, "new": 1.5, "session": False},
]


def evidence(state: str, now: dict[str, float], *, standing: Any = (), foreign: Any = None) -> Evidence:
    job = {
        "state": state,
        "plan": {"changes": CHANGES},
        "standing": list(standing),
        "outcome": None,
        "last_write": None,
    }
    return Evidence(job, Holding(OLD, OLD), Holding({**OLD, **now}, OLD), foreign or {})


def known(name: str, old: float, new: float, value: float | None, *, certain: bool) -> dict[str, Any]:
    return {"name": name, "old": old, "new": new, "value": value, "certain": certain}


DONE = {"A": float(np.float32(0.1)), "B": 1.5, "STAT_RUNTIME": 9.0}


class TestEnd:
    def test_written_and_nothing_else(self) -> None:
        assert judge(evidence("succeeded", DONE), ()) == (Ending.VERIFIED, ())

    @pytest.mark.parametrize(
        ("wrong", "said"),
        [
            ({"B": 1.0}, "B holds 1 instead of 1.5"),
            ({"SESSION": 0.0}, "SESSION holds 0 instead of 1"),
            ({"C": 6.0}, "C changed from 5 to 6"),
        ],
    )
    def test_success_that_is_none(self, wrong: dict[str, float], said: str) -> None:
        ending, complaints = judge(evidence("succeeded", {**DONE, **wrong}), ())
        assert ending == Ending.FAILURE
        assert any(said in complaint for complaint in complaints)

    def test_a_sensor_that_is_still_off(self) -> None:
        off = Residual("gyro", 1, worst=0.01, bound=0.002)
        ending, complaints = judge(evidence("succeeded", DONE), (off,))
        assert ending == Ending.FAILURE
        assert "gyro 1 is off" in complaints[0]

    @pytest.mark.parametrize(
        ("switch", "name"), [("IMU_GYRO_CAL_EN", "CAL_GYRO1_XOFF"), ("INS_GYR_CAL", "INS_GYR2OFFS_Z")]
    )
    @pytest.mark.parametrize("by_itself", [True, False])
    def test_a_gyro_offset_may_move_only_where_the_vehicle_calibrates_by_itself(
        self, switch: str, name: str, by_itself: bool
    ) -> None:
        old = {**OLD, switch: float(by_itself), name: 0.01, name.replace("OFF", "ID"): 3.0}
        job = {"state": "succeeded", "plan": {"changes": CHANGES}, "standing": [], "outcome": None, "last_write": None}
        now = {**old, **DONE, name: 0.03}
        ending, complaints = judge(Evidence(job, Holding(old, old), Holding(now, old), {}), ())
        assert (ending == Ending.VERIFIED) == by_itself, complaints
        worse = {**now, name.replace("OFF", "ID"): 4.0}
        assert judge(Evidence(job, Holding(old, old), Holding(worse, old), {}), ())[0] == Ending.FAILURE

    @pytest.mark.parametrize(("sent", "state"), [(0, "review"), (1, "review"), (0, "reverted")])
    def test_a_planned_gyro_offset_may_move_by_itself_while_nothing_is_sent(self, sent: int, state: str) -> None:
        name = "CAL_GYRO1_XOFF"
        old = {**OLD, "IMU_GYRO_CAL_EN": 1.0, name: 0.01}
        changes = [{"name": name, "old": 0.01, "new": 0.02, "session": False}]
        job = {
            "state": state,
            "plan": {"changes": changes},
            "standing": [],
            "outcome": None,
            "last_write": {"sent": sent},
        }
        now = Holding({**old, name: 0.03}, old)
        ending, _ = judge(Evidence(job, Holding(old, old), now, {}), ())
        assert (ending == Ending.AS_BEFORE) == (not sent and state == "review")

    @pytest.mark.parametrize(
        ("held", "own", "named", "good"),
        [
            (0.03, OwnWrite(0.03, after_end=False), True, True),
            (0.03, OwnWrite(0.03, after_end=False), False, False),
            (0.03, OwnWrite(0.03, after_end=True), False, True),
            (0.04, OwnWrite(0.03, after_end=True), True, False),
        ],
    )
    def test_what_the_vehicle_stores_by_itself_in_mid_write_has_to_be_named(
        self, held: float, own: OwnWrite, named: bool, good: bool
    ) -> None:
        name = "CAL_GYRO1_XOFF"
        old = {**OLD, "IMU_GYRO_CAL_EN": 1.0, name: 0.01}
        changes = [{"name": name, "old": 0.01, "new": 0.02, "session": False}]
        standing = [known(name, 0.01, 0.02, held, certain=True)] if named else []
        job = {"state": "reverted", "plan": {"changes": changes}, "standing": standing, "outcome": None}
        now = Holding({**old, name: held}, old)
        ending, _ = judge(Evidence({**job, "last_write": {"sent": 1}}, Holding(old, old), now, {}, {name: own}), ())
        assert (ending == Ending.AS_BEFORE) == good

    @pytest.mark.parametrize("state", ["reverted", "review", "interrupted"])
    def test_as_before(self, state: str) -> None:
        assert judge(evidence(state, {}), ())[0] == Ending.AS_BEFORE
        assert judge(evidence(state, {"A": 0.1}), ())[0] == Ending.FAILURE

    def test_a_third_party_has_to_be_named(self) -> None:
        held = evidence("reverted", {"A": 0.7}, foreign={"A": 0.7})
        assert judge(held, ())[0] == Ending.FAILURE
        named = evidence("reverted", {"A": 0.7}, foreign={"A": 0.7}, standing=[known("A", 0.0, 0.1, 0.7, certain=True)])
        assert judge(named, ())[0] == Ending.AS_BEFORE

    def test_any_other_state_is_a_failure(self) -> None:
        assert judge(evidence("failed", {}), ())[0] == Ending.FAILURE


class TestDoubt:
    def test_a_true_list(self) -> None:
        told = [known("A", 0.0, 0.1, 0.1, certain=True), known("B", 1.0, 1.5, None, certain=False)]
        for b in (1.0, 1.5):
            assert doubt_complaints(evidence("in_doubt", {"A": 0.1, "B": b}, standing=told)) == ()

    @pytest.mark.parametrize(
        "now", [{"A": 0.0}, {"A": 0.1, "B": 1.2}, {"A": 0.1, "C": 4.0}, {"A": 0.1, "SESSION": 0.0}]
    )
    def test_a_list_that_is_not_true(self, now: dict[str, float]) -> None:
        told = [known("A", 0.0, 0.1, 0.1, certain=True), known("B", 1.0, 1.5, None, certain=False)]
        assert doubt_complaints(evidence("in_doubt", now, standing=told))


class TestStop:
    """Strikes at 10 s, visible from 12 s on."""

    @staticmethod
    def complaints(*states: tuple[float, str], sets: tuple[float, ...] = ()) -> tuple[str, ...]:
        stop = Stop("arm", 10.0, 12.0, ((5.0, "applying"), *states))
        return stop_complaints((stop,), [(9.0, "A", 0.1), *((t, "B", 1.5) for t in sets)])

    def test_a_doubt_and_nothing_more_sent_is_good(self) -> None:
        assert self.complaints((11.0, "in_doubt")) == ()
        assert self.complaints((11.0, "in_doubt"), sets=(10.5,)) == ()  # it had left before
        assert self.complaints((11.0, "in_doubt"), (14.0, "rolling_back"), sets=(15.0,)) == ()

    def test_going_on_without_a_doubt_is_not(self) -> None:
        assert "never in doubt" in self.complaints((20.0, "verifying"), (30.0, "succeeded"))[0]
        said = self.complaints((20.0, "verifying"), sets=(13.0, 14.0))
        assert any("2 PARAM_SETs" in complaint for complaint in said)

    def test_a_doubt_that_comes_after_more_was_sent_is_not(self) -> None:
        assert self.complaints((16.0, "in_doubt"), sets=(13.0,)) == ("1 PARAM_SETs arrived long after arm: B",)

    def test_a_doubt_from_before_does_not_count(self) -> None:
        assert self.complaints((8.0, "in_doubt"), (9.0, "rolling_back"))

    @pytest.mark.parametrize("state", ["succeeded", "reverted", "waiting_for_reboot"])
    def test_what_had_ended_or_awaits_a_restart_need_not_doubt(self, state: str) -> None:
        assert self.complaints((11.0, state)) == ()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_residuals_fall_to_nothing_under_the_true_calibration(autopilot: str) -> None:
    """The judge's own formulas against the simulator's: the true values leave nothing, a wrong one shows."""
    with SimulatedVehicle(autopilot, seed=4, speed=50.0, config={"thermal": False}) as vehicle:
        truth = vehicle.truth()
        in_force = {name: float(value) for name, value in vehicle.parameters()[0].items()}
    asked = {"gyro": {"uncertainty": 0.001}, "accel": {"uncertainty": 0.001}, "mag": {"uncertainty": 0.01}}
    held = {**in_force, **_true_parameters(truth)}
    for job, options in asked.items():
        count = range(len(truth[f"{job}s"]))
        assert all(r.good for r in residuals(truth, held, job, options, count)), job
        assert not any(r.good for r in residuals(truth, _spoilt(held, job), job, options, count)), job


def _true_parameters(truth: dict[str, Any]) -> dict[str, float]:
    """The parameters that undo the truth; the accelerometer's scale is that of the symmetric part."""
    found: dict[str, float] = {}
    px4 = truth["autopilot"] == "px4"
    for k in range(3):
        n = str(k + 1) if k else ""
        gyro, accel = truth["gyros"][k], truth["accels"][k]
        scale = np.diag(_symmetric(np.linalg.inv(accel["matrix"])))
        names = (f"CAL_GYRO{k}_{{}}OFF", f"CAL_ACC{k}_{{}}OFF", f"CAL_ACC{k}_{{}}SCALE")
        ardupilot = (f"INS_GYR{n}OFFS_{{}}", f"INS_ACC{n}OFFS_{{}}", f"INS_ACC{n}SCAL_{{}}")
        for name, values in zip(names if px4 else ardupilot, (gyro["offset"], accel["offset"], scale), strict=True):
            found |= {name.format(axis): float(v) for axis, v in zip("XYZ", values, strict=True)}
    for k, mag in enumerate(truth["mags"]):
        found |= _true_compass(mag, k, px4=px4)
    return found


def _true_compass(mag: dict[str, Any], k: int, *, px4: bool) -> dict[str, float]:
    n = str(k + 1) if k else ""
    matrix = _symmetric(np.linalg.inv(mag["matrix" if px4 else "body_matrix"]))
    off = [matrix[0, 1], matrix[0, 2], matrix[1, 2]]
    offset = np.array(mag["offset"]) / 100.0 if px4 else -np.array(mag["body_offset"]) / 0.1
    found = {} if px4 else {f"COMPASS_SCALE{n}": 1.0}
    for i, axis in enumerate("XYZ"):
        if px4:
            found |= {f"CAL_MAG{k}_{axis}OFF": offset[i], f"CAL_MAG{k}_{axis}SCALE": matrix[i, i]}
            found[f"CAL_MAG{k}_{axis}ODIAG"] = off[i]
        else:
            found |= {f"COMPASS_OFS{n}_{axis}": offset[i], f"COMPASS_DIA{n}_{axis}": matrix[i, i]}
            found[f"COMPASS_ODI{n}_{axis}"] = off[i]
    return found


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    """The symmetric factor of a matrix: what is left of it without its rotation."""
    _, singular, vt = np.linalg.svd(matrix)
    return vt.T @ np.diag(singular) @ vt


def _spoilt(held: dict[str, float], job: str) -> dict[str, float]:
    """One axis of every offset of this kind wrong, by 0.02 m/s2, 0.02 rad/s or 5 uT."""
    starts = {"gyro": ("INS_GYR", "CAL_GYRO"), "accel": ("INS_ACC", "CAL_ACC"), "mag": ("COMPASS_OFS", "CAL_MAG")}[job]
    wrong = {"INS": 0.02, "COM": 50.0, "CAL": 0.05 if job == "mag" else 0.02}
    ends = ("OFFS_Y", "_YOFF") if job != "mag" else ("_Y", "_YOFF")
    chosen = [name for name in held if name.startswith(starts) and name.endswith(ends)]
    return {**held, **{name: held[name] + wrong[name[:3]] for name in chosen}}


def test_the_same_seed_draws_the_same_runs_of_every_kind() -> None:
    one, other = scenarios(240, 3), scenarios(240, 3)
    assert one == other
    assert one != scenarios(240, 4)
    assert one[:20] == scenarios(20, 3)
    assert {strike.kind for scenario in one for strike in scenario.strikes} == set(KINDS)


def test_a_parameter_is_held_back_by_the_fault_that_met_its_own_set():
    """Two at one time of the vehicle's clock; the third repeats the second."""
    sets = [[9.0, "A", 1.0], [9.0, "B", 2.0], [9.5, "B", 2.0], [9.6, "C", 3.0]]
    state = {"param_sets": 14, "param_set_list": sets}

    def fault(nth: int, *struck: float, kind: str = "not_applied") -> dict[str, Any]:
        return {"kind": kind, "nth_set": nth, "struck": list(struck)}

    assert held_back(state, [fault(11, 9.0)]) == ["A"]
    assert held_back(state, [fault(12, 9.0), fault(14)]) == ["B"]
    assert held_back(state, [fault(13, 9.5)]) == []
    assert held_back(state, [fault(11, 9.0, kind="foreign_write")]) == []
