"""Diagnosed, exported, simulated again with the export: nothing is left, and the same effects are found again."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib import gap
from mavcal.calib.gap.export import Target, exported
from mavcal.calib.gap.schema import GapReport, GapVerdict
from mavcal.calib.gap.verify import verified_json, verify
from mavcal.calib.recording import Recording, Sensor
from mavcal.calib.simulate import SensorErrors, SensorSuite
from mavcal.calib.simulate.document import stated_in
from tests.unit.gap.recorded import CLEAN, REAL, recorded

SECONDS = 30.0


@pytest.fixture(scope="module")
def real() -> Recording:
    return recorded(REAL, 10, seconds=SECONDS)


@pytest.fixture(scope="module")
def report(real: Recording) -> GapReport:
    return gap.run(real, nested=False)


def again(text: str, suffix: str) -> SensorSuite:
    """The sensors that a file states, with the noise of the clean ones; a fresh SITL's compass offset taken off."""
    stated = stated_in(text, suffix).suite
    iron = np.array([-0.5, -1.3, 1.8]) if suffix == ".parm" else np.zeros(3)
    made = {}
    for sensor, errors in stated.by_sensor.items():
        made[sensor.value] = SensorErrors(
            bias=errors.bias - (iron if sensor is Sensor.MAG else 0.0),
            matrix=errors.matrix,
            temperature=errors.temperature,
            t_ref=errors.t_ref,
            noise_density=CLEAN.by_sensor[sensor].noise_density,
        )
    return SensorSuite(**made)


@pytest.mark.long
@pytest.mark.parametrize(("target", "suffix"), [(Target.SITL, ".parm"), (Target.MAVCAL, ".json")])
def test_the_simulator_with_the_export_has_the_same_gap(
    report: GapReport, real: Recording, target: Target, suffix: str
) -> None:
    assert report.verdict is GapVerdict.EXPLAINED
    made = exported(report, real, target)
    assert made.not_held == ()
    simulated = recorded(again(made.text, suffix), 31, seconds=SECONDS)
    found = verified_json(verify(report, real, None, simulated))
    assert found["closed"] > 0.999
    assert found["remaining"]["nats"] < 0.01
    assert all(effect["share"] < 1e-3 for effect in found["effects"])


@pytest.mark.long
def test_what_the_effects_carry_adds_up_to_the_export(report: GapReport, real: Recording) -> None:
    text = exported(report, real, Target.SITL).text
    whole = {line.split()[0]: float(line.split()[1]) for line in text.splitlines() if not line.startswith("#")}
    parts: dict[str, float] = {}
    for effect in report.effects:
        for name, value in effect.sim_patch.items():
            assert parts.setdefault(name, value) == value
    assert parts == pytest.approx(whole, rel=1e-6)
