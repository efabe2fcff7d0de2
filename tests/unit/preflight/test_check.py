"""The rule by which a value with its uncertainty is judged, and what a report comes to."""

from __future__ import annotations

import pytest

from mavcal.calib.preflight import limits as named
from mavcal.calib.preflight.check import ASKS, Check, CheckId, Measure, Report, Verdict, judged, unknown
from scripts import checks


def measure(value: float, sd: float, limit: float = 1.0) -> Measure:
    return Measure("it", value, sd, limit, "deg")


@pytest.mark.parametrize(
    ("value", "sd", "verdict"),
    [
        (0.5, 0.1, Verdict.PASS),
        (1.2, 0.1, Verdict.WARN),
        (1.31, 0.1, Verdict.FAIL),
        (0.5, 0.4, Verdict.UNKNOWN),
        (2.5, 0.4, Verdict.FAIL),
    ],
)
def test_a_value_fails_only_beyond_doubt(value: float, sd: float, verdict: Verdict) -> None:
    assert measure(value, sd).verdict == verdict


def test_the_worst_number_decides_and_all_are_evidence() -> None:
    check = judged(CheckId.GYRO_REST, [measure(0.1, 0.01), measure(3.0, 0.1)], good="fine", remedy="mend it")
    assert (check.verdict, check.value, check.sd, check.remedy) == (Verdict.FAIL, 3.0, 0.1, "mend it")
    assert len(check.evidence) == 2


def test_a_pass_has_no_remedy() -> None:
    check = judged(CheckId.GYRO_REST, [measure(0.1, 0.01)], good="fine", remedy="mend it")
    assert (check.verdict, check.reason, check.remedy) == (Verdict.PASS, "fine", "")


@pytest.mark.parametrize(
    ("verdicts", "whole"),
    [
        ((Verdict.PASS, Verdict.UNKNOWN, Verdict.WARN, Verdict.FAIL), Verdict.FAIL),
        ((Verdict.PASS, Verdict.UNKNOWN, Verdict.WARN), Verdict.WARN),
        ((Verdict.PASS, Verdict.UNKNOWN), Verdict.UNKNOWN),
        ((Verdict.PASS,), Verdict.PASS),
    ],
)
def test_the_verdict_of_the_whole(verdicts: tuple[Verdict, ...], whole: Verdict) -> None:
    found = tuple(Check(CheckId.VIBRATION, verdict, None, None, None, "", "") for verdict in verdicts)
    assert Report(found).verdict == whole


def test_a_consequence_is_not_a_failure_of_its_own() -> None:
    check = judged(CheckId.ACCEL_FORCE, [measure(3.0, 0.1)], good="fine", remedy="mend it")
    told = check.because_of(CheckId.SENSOR_IDS)
    assert told.verdict == Verdict.UNKNOWN
    assert "sensor_ids" in told.reason
    assert told.value == 3.0


def test_the_summary_names_what_failed() -> None:
    failed = judged(CheckId.ACCEL_FORCE, [measure(3.0, 0.1)], good="", remedy="")
    assert "accel_force failed" in Report((failed, unknown(CheckId.VIBRATION, "not heard"))).summary


def test_one_check_deserves_a_look_and_two_deserve_one() -> None:
    turned, shaking = (
        judged(of, (measure(1.1, 0.2),), good="", remedy="Look.")
        for of in (CheckId.COMPASS_DIRECTION, CheckId.VIBRATION)
    )
    assert "compass_direction deserves " in Report((turned,)).summary
    assert "compass_direction, vibration" in Report((turned, shaking)).summary
    assert "vibration deserve " in Report((turned, shaking)).summary


def test_the_page_lists_every_check_and_limit_as_the_code_has_them() -> None:
    written = checks.PAGE.read_text(encoding="utf-8")
    assert checks.page(written) == written, "scripts/checks writes the tables"
    for of, asks in ASKS.items():
        assert f"| `{of}` | {asks} |" in written
    assert set(ASKS) == set(CheckId)
    assert {limit.of.partition(",")[0] for limit in named.ALL} <= {of.value for of in CheckId}
