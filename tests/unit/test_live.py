from __future__ import annotations

import numpy as np

from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.service.live import STALE_BATCHES, OneSource


def channel(source: str, count: int, *, quantum: float = 0.0, stage: Stage = Stage.CORRECTED) -> Channel:
    t = np.arange(count) / 50
    return Channel(Sensor.ACCEL, 0, t, np.zeros((count, 3)), "m/s2", stage, source, quantum)


def sources(of: OneSource, *channels: Channel) -> list[str]:
    return [channel.source for channel in of.take(channels)]


def test_two_messages_of_one_sensor_are_never_mixed() -> None:
    one = OneSource()
    assert sources(one, channel("RAW_IMU", 5, quantum=0.01), channel("HIGHRES_IMU", 4)) == ["HIGHRES_IMU"]
    assert sources(one, channel("RAW_IMU", 5, quantum=0.01), channel("HIGHRES_IMU", 5)) == ["HIGHRES_IMU"]
    for _ in range(STALE_BATCHES):  # it may only be late
        assert sources(one, channel("RAW_IMU", 5, quantum=0.01)) == []
    assert sources(one, channel("RAW_IMU", 5, quantum=0.01)) == ["RAW_IMU"]
    assert sources(one, channel("RAW_IMU", 5, quantum=0.01), channel("HIGHRES_IMU", 5)) == ["RAW_IMU"]


def test_the_finer_message_is_chosen_unless_it_comes_seldom_or_lacks_the_bias() -> None:
    assert sources(OneSource(), channel("RAW_IMU", 9, quantum=0.01), channel("HIGHRES_IMU", 4)) == ["RAW_IMU"]
    debiased = channel("HIGHRES_IMU", 5, stage=Stage.DEBIASED)
    assert sources(OneSource(), channel("SCALED_IMU", 5, quantum=0.01), debiased) == ["SCALED_IMU"]


def test_nothing_of_what_is_not_shown_and_nothing_empty() -> None:
    attitude = Channel(Sensor.ATTITUDE, 0, np.zeros(1), np.ones((1, 4)), "1", Stage.CORRECTED, "ATTITUDE")
    assert sources(OneSource(), attitude, channel("RAW_IMU", 0)) == []
