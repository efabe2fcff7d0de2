"""Telemetry logs whose vehicle changes its mind, or whose clock was damaged."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.methods.overview import overview
from mavcal.calib.wire.tlog import tlog_record


def log(times_us: list[int], autopilots: list[int]) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    messages = [mav.heartbeat_encode(2, autopilot, 0, 0, 3) for autopilot in autopilots]
    messages.append(mav.param_value_encode(b"INS_ACCOFFS_X", 0.1, 9, 3, 1))
    messages += [mav.raw_imu_encode(t, 0, 0, -1000, 1, 2, 3, 200, 0, 400) for t in times_us]
    return b"".join(tlog_record(1_700_000_000_000_000 + k, m.pack(mav)) for k, m in enumerate(messages))


def test_a_vehicle_that_says_later_that_it_is_another_one_is_read():
    recording = read_tlog(log([1_000_000 + 20_000 * k for k in range(50)], [3, 4]))
    assert recording.parameters.end_observed is False


def test_a_damaged_stamp_costs_no_memory():
    times = [1_000_000 + 20_000 * k for k in range(200)]
    overview(read_tlog(log([*times, 2**63], [3])))  # asked for 866 TiB before
