"""The proof of whole jobs captured from a running ArduCopter: what is right stays, what had no effect goes."""

from __future__ import annotations

import lzma
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.firmware.names import ardupilot_compass_names, ardupilot_imu_names
from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, ProofVerdict, SensorVerdict, WritePlan
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.logs import read
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.registry import replay
from mavcal.calib.recording import ParameterTimeline, Recording, Sensor
from mavcal.service.jobs.calibrate.digest import context_of, field_of

pytestmark = pytest.mark.shared

AT = datetime(2026, 11, 26, tzinfo=UTC).timestamp()
OWNERS = {
    **{n: (s, k) for k in range(3) for s in (Sensor.ACCEL, Sensor.GYRO) for n in ardupilot_imu_names(s, k).values()},
    **{n: (Sensor.MAG, k) for k in range(3) for n in ardupilot_compass_names(k, k).values()},
    "AHRS_TRIM_X": (None, 0),
    "AHRS_TRIM_Y": (None, 0),
}


@dataclass(frozen=True)
class Run:
    """One captured job: all that was heard, and what was written."""

    whole: Recording
    plan: WritePlan
    written: tuple[float, float]
    """Times of the first and of the last new value."""

    @property
    def held(self) -> dict[str, Any]:
        """The parameters as they were stored before the write was taken back."""
        return self.before | {c.name: c.new for c in self.plan.changes}

    @property
    def before(self) -> dict[str, Any]:
        return {e.name: e.value for e in self.whole.parameters.entries if e.t < self.written[0]}

    def span(self, start: float, end: float) -> Recording:
        return Recording(
            tuple(c.take((c.t >= start) & (c.t <= end)) for c in self.whole.channels), identity=self.whole.identity
        )

    def fits(self, kind: str, end: float) -> Any:
        entries = tuple(e for e in self.whole.parameters.entries if e.t < end)
        captured = Recording(self.span(-1.0, end).channels, ParameterTimeline(entries), identity=self.whole.identity)
        context = context_of(kind, captured.identity, captured.parameters.final(), field_of(captured, AT))
        done = replay(kind, {}, context, undo(captured))
        assert isinstance(done, Done), done
        return done.results


def captured(shared_data: Any, tmp_path: Any, name: str) -> Run:
    """Read a capture; its plan is what was written until the first parameter was put back."""
    path = tmp_path / name
    path.write_bytes(lzma.decompress((shared_data / "firmware_runs" / f"{name}.xz").read_bytes()))
    whole = read(path)
    last: dict[str, Any] = {}
    changes: dict[str, Change] = {}
    times = []
    for entry in whole.parameters.entries:
        old = last.get(entry.name, entry.value)
        last[entry.name] = entry.value
        if old == entry.value or entry.name not in OWNERS:
            continue
        if entry.name in changes:
            break  # it is taken back
        sensor, instance = OWNERS[entry.name]
        changes[entry.name] = Change(entry.name, old, entry.value, ParameterKind.REAL32, "", None, "", sensor, instance)
        times.append(entry.t)
    plan = WritePlan(Fingerprint("ardupilot", "0123", "4.7.0", ()), "", tuple(changes.values()))
    return Run(whole, plan, (min(times), max(times)))


@pytest.fixture
def compasses(shared_data, tmp_path):
    return captured(shared_data, tmp_path, "ardupilot_mag_noise_3mG.tlog")


def test_one_late_sample_of_three_turned_compasses_takes_nothing_back(compasses):
    """It is 6 mG too short in all three, beside a scatter of 0.5 mG; all was right, 17 names were "without effect"."""
    fits, (start, end) = compasses.fits("mag", 203.0), compasses.written
    assert len(compasses.plan.changes) == 27
    earlier = compasses.span(203.0, start - 0.1)
    for until in (219.0, 225.0, 231.0, 240.0):
        result = verify(compasses.plan, fits, earlier, compasses.span(end + 1.2, until), parameters=compasses.held)
        assert result.must_go == "", until
    found = Counter(p.verdict for p in result.parameters)
    assert found[ProofVerdict.PROVED] >= 24


def test_the_same_write_without_effect_is_found(compasses):
    fits = compasses.fits("mag", 203.0)
    earlier, old = compasses.span(170.0, 180.0), compasses.span(180.0, 203.0)
    result = verify(compasses.plan, fits, earlier, old, parameters=compasses.held)
    assert len(result.contradicted) >= 24
    rest = {p.verdict for p in result.parameters if p.name not in result.contradicted}
    assert rest <= {ProofVerdict.NOT_OBSERVABLE}


def test_a_level_after_accelerometers_without_a_restart_stays(shared_data, tmp_path):
    run = captured(shared_data, tmp_path, "ardupilot_accel_then_level_2_level.tlog")
    start, end = run.written
    fits = run.fits("level", start)
    result = verify(run.plan, fits, run.span(start - 4.0, start), run.span(end + 0.5, end + 25.0), parameters=run.held)
    assert result.must_go == ""
    level, attitude = result.sensors
    assert (level.id, level.verdict) == ("level", SensorVerdict.RIGHT)
    assert level.value < np.radians(0.1)
    assert (attitude.id, attitude.verdict) == ("attitude", SensorVerdict.NOT_OBSERVABLE)
    assert attitude.text.startswith("the vehicle's attitude is 2.20 deg off accel 1:")
    assert attitude.text.endswith("restart the vehicle")


def test_a_thermal_calibration_over_a_hidden_tmax_of_zero_stays(shared_data, tmp_path):
    """The hypothesis "TMAX was not applied" leaves no temperature from the new TMIN to 0: no vehicle has it."""
    run = captured(shared_data, tmp_path, "ardupilot_thermal_tmax_zero.tlog")
    old = {c.name: c.old for c in run.plan.changes}
    assert old["INS_TCAL1_TMAX"] == 0.0
    start, end = run.written
    fits = run.fits("thermal", start - 6.0)
    result = verify(run.plan, fits, run.span(start - 5.0, start), run.span(end + 0.2, end + 7.5), parameters=run.held)
    assert result.must_go == ""
    verdicts = {p.name: p.verdict for p in result.parameters}
    assert verdicts["INS_TCAL1_ENABLE"] == verdicts["INS_GYROFFS_Z"] == ProofVerdict.PROVED
    assert len(verdicts) == len(run.plan.changes)
    before = verify(run.plan, fits, run.span(500.0, 520.0), run.span(521.0, 529.0), parameters=run.held)
    assert before.contradicted  # stored, and not in force
