from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of
from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.schema import LocatedGap
from mavcal.calib.gap.telling.locate import _tilt, located
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, Gap, problem_of

S = SIGMA[Sensor.GYRO]


def model_of(gap: Gap | None, seed: int = 1, **more: int) -> Model:
    """A gyroscope without any effect in its model."""
    return _setup_of(problem_of(np.random.default_rng(seed), (Sensor.GYRO,), gap, **more), ()).bare


def found(gap: Gap | None, **more: int) -> tuple[LocatedGap, ...]:
    return located(model_of(gap, **more), 0.005)


def on_y(values: np.ndarray) -> np.ndarray:
    made = np.zeros((len(values), 3))
    made[:, 1] = values
    return made


def test_noise_alone_is_nowhere() -> None:
    assert [found(None, seed=seed) for seed in range(4)] == [()] * 4


def test_a_constant_is_everywhere_on_its_axis() -> None:
    cells = found(lambda t: on_y(np.full(len(t.t), 3.0 * S)))
    assert {cell.channel for cell in cells} == {"gyro.y"}
    assert cells[0].regime.kind == "all"  # the largest loss in total
    assert cells[0].nats_per_sample == pytest.approx(4.5, rel=0.15)  # half of (3 sd)^2
    assert cells[0].rms == pytest.approx(S * np.sqrt(10.0), rel=0.05)
    assert (cells[0].unit, cells[0].instance) == ("rad/s", 1)


def test_a_gap_at_one_time_is_found_there_and_nowhere_else() -> None:
    """Between a third and a half of the flight, more noise."""
    rng = np.random.default_rng(7)

    def gap(trace) -> np.ndarray:
        inside = (trace.t > 40.0 / 3.0) & (trace.t < 20.0)
        return on_y(4.0 * S * rng.normal(size=len(trace.t)) * inside)

    times = [cell for cell in found(gap) if cell.regime.kind == "time"]
    assert [cell.regime.bin for cell in times] == [(pytest.approx(13.3, abs=0.1), pytest.approx(20.0, abs=0.1))]
    assert times[0].nats_per_sample == pytest.approx(8.0, rel=0.15)


def test_a_tone_is_found_in_its_band() -> None:
    cells = found(lambda t: on_y(2.0 * S * np.sin(2 * np.pi * 10.0 * t.t)))
    bands = [cell.regime for cell in cells if cell.regime.kind == "band"]
    assert bands
    assert all(low <= 10.0 < high for low, high in (band.bin for band in bands))
    assert {band.unit for band in bands} == {"Hz"}


def test_a_gap_that_grows_with_the_current_is_largest_where_it_is_largest() -> None:
    cells = [c for c in found(lambda t: on_y(0.6 * S * (t.current - t.current.mean()))) if c.regime.kind == "current"]
    assert {cell.regime.unit for cell in cells} == {"A"}
    worst = max(cells, key=lambda cell: cell.nats_per_sample)
    assert worst.regime.bin[1] == max(cell.regime.bin[1] for cell in cells)


def test_every_recorded_condition_is_a_regime() -> None:
    kinds = {cell.regime.kind for cell in found(lambda t: on_y(np.full(len(t.t), 5.0 * S)))}
    assert {"all", "time", "temperature", "current", "throttle", "rate", "force", "attitude", "band"} <= kinds


def test_the_chance_of_a_cell_pays_for_all_of_them_and_the_largest_loss_comes_first() -> None:
    model = model_of(lambda t: on_y(np.full(len(t.t), 0.12 * S)))
    every = located(model, 1.0)
    few = located(model, 0.005)
    assert 0 < len(few) < len(every)
    assert all(cell.p_holm < 0.005 for cell in few)
    totals = [cell.nats_per_sample for cell in every if cell.regime.kind == "all"]
    assert totals == sorted(totals, reverse=True)


def test_the_instance_with_the_gap_is_named() -> None:
    cells = found(lambda t: on_y(np.full(len(t.t), 3.0 * S)), instances=2, only=1)
    assert {cell.instance for cell in cells} == {2}


@pytest.mark.parametrize(
    ("q", "degrees"), [((1, 0, 0, 0), 0.0), ((0, 1, 0, 0), 180.0), ((1, 1, 0, 0), 90.0), ((2, 0, 0, 5), 0.0)]
)
def test_the_attitude_is_the_angle_from_upright_whatever_the_heading(q: tuple[int, ...], degrees: float) -> None:
    assert _tilt(np.array([q], dtype=float))[0] == pytest.approx(degrees)
