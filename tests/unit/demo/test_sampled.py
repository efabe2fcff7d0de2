"""When the samples of a job were taken: what a demonstration compares it with is the truth of that time."""

from __future__ import annotations

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.client.jobs import SegmentModel
from mavcal.service.demo.run import sampled


def stream(first: float, last: float) -> bytes:
    """A log of a telemetry link with an accelerometer and a gyroscope at 50 Hz, vehicle seconds."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    parts = []
    for k in range(int((last - first) * 50) + 1):
        t = first + k / 50
        boot = dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(mav) if k % 50 == 0 else b""
        raw = dialect.MAVLink_scaled_imu2_message(round(t * 1000), 0, 0, -1000, 1, 2, 3, 0, 0, 0, 2500).pack(mav)
        stamp = struct.pack(">Q", round((1.7e9 + t) * 1e6))
        parts.append((stamp + boot if boot else b"") + stamp + raw)
    return b"".join(parts)


@pytest.fixture
def logged(tmp_path):
    def of(*quality):
        earlier, content = stream(0.0, 5.0), stream(900.0, 960.0)
        (tmp_path / "a.tlog").write_bytes(earlier + content)
        end = len(earlier) + len(content)
        span = SegmentModel(path="a.tlog", start_byte=len(earlier), end_byte=end, sha256="")
        return sampled(tmp_path, [span], quality)

    return of


def test_it_is_from_the_first_to_the_last_sample_of_the_segment(logged):
    assert logged({}) == (pytest.approx(900.0), pytest.approx(960.0))


def test_a_rest_begins_and_ends_when_its_fit_says_so_and_not_when_the_parameters_were_read(logged):
    rests = {"began": 910.0, "duration": 20.0}, {"began": 911.0, "duration": 20.0}
    assert logged(*rests) == (pytest.approx(910.0), pytest.approx(931.0))


def test_a_rest_ends_with_its_segment(logged):
    assert logged({"began": 910.0, "duration": 900.0}) == (pytest.approx(910.0), pytest.approx(960.0))
