"""Which sensors a job left out: those that it was to calibrate, and those whose help it did without."""

from __future__ import annotations

import pytest

from mavcal.calib.firmware.plan import LeftOut
from mavcal.calib.recording import Sensor
from mavcal.service.jobs.core.model import Job, cancelled
from mavcal.service.jobs.core.states import JobState

GYRO, ACCEL = LeftOut(Sensor.GYRO, 0, "it is frozen"), LeftOut(Sensor.ACCEL, 1, "it does not stream")


def job(kind: str, *missed: LeftOut, vehicle: str | None = "v1") -> Job:
    return Job("one", vehicle, kind, {}, JobState.SUCCEEDED, 0.0, 0.0, missed=missed)


@pytest.mark.parametrize(
    ("kind", "left_out", "broken"),
    [("gyro", (GYRO,), (ACCEL,)), ("accel", (ACCEL,), (GYRO,)), ("mag", (), (ACCEL, GYRO))],
)
def test_only_what_it_was_to_calibrate_makes_a_job_done_in_part(kind, left_out, broken):
    one = job(kind, GYRO, ACCEL)
    assert (one.left_out, one.broken) == (left_out, broken)


def test_a_cancelled_job_says_that_nothing_was_written_where_something_could_have_been():
    of_vehicle, of_file = cancelled(job("gyro")), cancelled(job("fit", vehicle=None))
    assert of_vehicle.code == of_file.code == "cancelled"
    assert "Nothing was" in of_vehicle.cause
    assert "Nothing was" not in of_file.cause
