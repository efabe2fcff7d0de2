from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from mavcal.calib.procedures.pool import BLOCK, Pool
from mavcal.calib.recording import Channel, Sensor, Stage

GYRO = (Sensor.GYRO, 0)
PER_TICK = 12


def tick(k: int) -> Channel:
    t = 0.25 * k + 0.02 * np.arange(PER_TICK)
    return Channel(Sensor.GYRO, 0, t, np.column_stack([t, -t, 2 * t]), "rad/s", Stage.RAW, "test")


@pytest.mark.parametrize("asked_at", [(), (1,), (BLOCK - 1, BLOCK), (5, 3 * BLOCK)])
def test_every_sample_is_kept_in_order_whenever_it_is_asked_for(asked_at: tuple[int, ...]) -> None:
    pool = Pool((Sensor.GYRO,))
    for k in range(3 * BLOCK + 7):
        pool.add({GYRO: tick(k), (Sensor.ACCEL, 0): tick(k)})
        if k in asked_at:
            assert len(pool.channel(GYRO)) == (k + 1) * PER_TICK
    channel = pool.channel(GYRO)
    expected = np.concatenate([tick(k).t for k in range(3 * BLOCK + 7)])
    np.testing.assert_array_equal(channel.t, expected)
    np.testing.assert_array_equal(channel.values[:, 2], 2 * expected)
    assert (Sensor.ACCEL, 0) not in pool
    assert pool.get((Sensor.ACCEL, 0)) is None


def test_an_hour_costs_little_more_than_its_numbers() -> None:
    pool = Pool((Sensor.GYRO,))
    numbers = 4 * 8 * PER_TICK
    pool.add({GYRO: tick(0)})
    tracemalloc.start()
    for k in range(1, 20 * BLOCK + 1):
        pool.add({GYRO: tick(k)})
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 1.5 * 20 * BLOCK * numbers
