"""What a person confirms on a terminal, and jobs that are written later: ``calibrate``, ``plan`` and ``accept``."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store import SqliteStore

from .test_api_recording_jobs import without_version
from .test_cli_recovery import Command, stored

pytestmark = pytest.mark.timeout(300)

TURNED, STATED = 6, 0
"""Rotations by number: yaw 270 deg, none."""
ACCEPT = re.compile(r"`mavcal accept (\w+) --confirm-mounting --connect \S+ --data-dir \S+` writes it")


def mounted_otherwise() -> SimulatedVehicle:
    config = {
        "thermal": False,
        "imu_count": 1,
        "mag_count": 2,
        "mag_orientations": [STATED, TURNED],
        "mag_orientation_parameters": [STATED, STATED],
        "parameters": {"INS_GYR_CAL": 0},
    }
    return SimulatedVehicle("ardupilot", seed=5, speed=20, config=config)


@pytest.fixture
def sim() -> Iterator[SimulatedVehicle]:
    with mounted_otherwise() as vehicle:
        vehicle.call("tumble", rate_dps=45.0)
        yield vehicle


@pytest.fixture
def mavcal(tmp_path: Path, sim: SimulatedVehicle) -> Command:
    return Command(tmp_path, sim)


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of a terminal: that of the person who types, and that of the command."""
    person, command = os.openpty()
    yield person, command
    os.close(person)
    os.close(command)


@pytest.mark.long
def test_a_mounting_is_told_in_words_and_confirmed_on_the_terminal(sim, mavcal, terminal):
    person, stdin = terminal
    run = mavcal.begun("calibrate", "mag", "--apply", stdin=stdin)
    run.until("type yes to confirm")
    assert f"to be confirmed: compass 2 is mounted turned by yaw 270: COMPASS_ORIENT2 changes from {STATED} (none)" in (
        run.said
    )
    assert stored(sim)["COMPASS_ORIENT2"] == STATED
    os.write(person, b"yes\n")
    assert run.ended() == 0, run.said
    assert "as confirmed: COMPASS_ORIENT2 changes" in run.said
    assert stored(sim)["COMPASS_ORIENT2"] == TURNED


@pytest.mark.long
def test_what_is_not_confirmed_waits_and_is_accepted_later_without_turning_again(sim, mavcal, terminal, tmp_path):
    person, stdin = terminal
    before = stored(sim)
    run = mavcal.begun("calibrate", "mag", "--apply", stdin=stdin)
    run.until("type yes to confirm")
    os.write(person, b"\n")
    assert run.ended() == 1, run.said
    found = ACCEPT.search(run.said)
    assert found is not None, run.said
    assert stored(sim) == before

    sim.call("hold", pose=[0.0, 0.0, 0.0], tilt_deg=0.0, tremor_deg=0.0)
    code, job, said = mavcal.ran("accept", found[1])  # a script, which says nothing
    assert (code, job["state"]) == (1, "review"), said
    assert stored(sim) == before
    code, job, said = mavcal.ran("accept", found[1], "--confirm-mounting")
    assert (code, job["state"]) == (0, "succeeded"), said
    assert job["id"] == found[1]
    assert stored(sim)["COMPASS_ORIENT2"] == TURNED
    assert confirmed(tmp_path) == ["confirm_mounting"]


@pytest.mark.long
def test_a_log_without_a_board_id_is_written_only_as_confirmed(sim, mavcal, tmp_path):
    sim.call("still")
    code, job, said = mavcal.ran("calibrate", "gyro")
    assert (code, job["state"]) == (0, "review"), said
    (tlog,) = (tmp_path / "tlogs").rglob("*.tlog")
    log = tmp_path / "flight.tlog"
    log.write_bytes(without_version(tlog.read_bytes()[: job["segments"][-1]["end_byte"]]))
    before = stored(sim)

    code, job, said = mavcal.ran("plan", "gyro-rest", str(log), "--apply")
    assert (code, job["state"], job["kind"]) == (1, "review", "recording"), said
    assert "does not say which board it is of" in said
    assert (
        f"mavcal accept {job['id']} --confirm-other-unit --connect {sim.url} --data-dir {tmp_path}` writes it" in said
    )
    assert stored(sim) == before
    code, job, said = mavcal.ran("accept", job["id"], "--confirm-other-unit")
    assert (code, job["state"]) == (0, "succeeded"), said
    assert "the operator has confirmed that it is of this vehicle" in said
    assert stored(sim) != before
    assert confirmed(tmp_path) == ["confirm_other_unit"]

    code, job, said = mavcal.ran("plan", "gyro-rest", str(log), "--apply", "--confirm-other-unit")
    assert (code, job["plan"]["changes"]) == (0, []), said


@pytest.mark.long
def test_a_job_of_another_vehicle_or_of_none_is_refused(sim, mavcal, tmp_path):
    sim.call("still")
    assert mavcal.ran("accept", "nothing")[0] == 1
    _, job, _ = mavcal.ran("calibrate", "gyro")
    with SimulatedVehicle("ardupilot", seed=8, speed=20, system_id=9, config={"thermal": False}) as other:
        code, told, _ = Command(tmp_path, other).ran("accept", job["id"])
        assert (code, told["error"]["code"]) == (1, "other-vehicle")


def confirmed(data_dir: Path) -> list[str]:
    """What the newest accept has confirmed, by the audit trail."""
    store = SqliteStore(data_dir)
    try:
        (*_, newest) = [row for row in store.audit() if row.action == "apply"]
    finally:
        store.close()
    return list(newest.detail["confirmed"])
