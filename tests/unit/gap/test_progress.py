from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.progress import GapPace, GapProgress, GapStage, unsearched, with_limit
from mavcal.calib.gap.schema import GapReport, GapVerdict, as_json
from mavcal.calib.gap.search.contest import Contest, ContestScore
from mavcal.calib.gap.telling.recordings import inputs_of
from mavcal.calib.gap_report.words import verdict_sentence
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

A, G = Sensor.ACCEL, Sensor.GYRO


class Watch:
    """A clock that goes on by `step` each time that it is read."""

    def __init__(self, step: float = 0.0, now: float = 0.0) -> None:
        self.now, self.step = now, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


def biased() -> GapProblem:
    offsets = {A: np.array([0.3, -0.2, 0.1]), G: np.array([0.02, 0.01, -0.02])}
    return problem_of(np.random.default_rng(1), (A, G), lambda trace: np.tile(offsets[trace.sensor], (len(trace.t), 1)))


def diagnosed(elapsed: Callable[[], float] | None, limit_s: float, told: list[GapProgress] | None = None) -> GapReport:
    heard: list[GapProgress] = [] if told is None else told
    return diagnose(biased(), pace=GapPace(elapsed, limit_s, heard.append))


def test_a_limit_needs_a_clock_and_a_length() -> None:
    with pytest.raises(InvalidInputError, match="measures the time"):
        GapPace(limit_s=3.0)
    for limit in (0.0, -1.0, float("nan")):
        with pytest.raises(InvalidInputError, match="above zero"):
            GapPace(Watch(), limit)


def test_without_a_limit_nothing_ends() -> None:
    assert not GapPace().ends(1e9)
    assert not GapPace(Watch(step=1e6)).ends(1e9)


def test_a_stage_ends_at_its_part_of_the_limit_and_what_was_left_out_is_kept() -> None:
    watch = Watch()
    pace = GapPace(watch, 100.0)
    pace.begin(GapStage.SELECTION)
    watch.now = 40.0
    assert not pace.ends()
    assert not pace.left_out
    assert pace.ends(needs_s=40.0)
    assert pace.ended
    assert list(pace.left_out) == [GapStage.SELECTION]
    pace.begin(GapStage.REPORT)
    assert not pace.ended
    watch.now = 1e6
    assert not pace.ends()


def test_a_search_leaves_the_time_that_its_effects_need_afterwards() -> None:
    """A flight alone found eleven effects in time, and held blocks out for three minutes more."""
    watch = Watch()
    pace = GapPace(watch, 100.0)
    pace.begin(GapStage.SELECTION)
    pace.reserve(4, 1.0)
    watch.now = 41.0
    assert not pace.ends()
    watch.now = 43.0
    assert pace.ends()
    pace.begin(GapStage.HELD_OUT)
    watch.now = 69.0
    assert not pace.ends()
    watch.now = 71.0
    assert pace.ends()


def test_the_time_left_is_told_from_the_time_gone_and_never_more_than_the_limit_leaves() -> None:
    told: list[GapProgress] = []
    watch = Watch()
    pace = GapPace(watch, 100.0, told.append)
    pace.begin(GapStage.REFERENCE)
    assert (told[-1].stage, told[-1].left_s) == (GapStage.REFERENCE, None)
    first = told[-1].share
    watch.now = 10.0
    pace.begin(GapStage.SELECTION)
    assert told[-1].left_s == pytest.approx(10.0 * (1.0 - told[-1].share) / (told[-1].share - first))
    watch.now = 90.0
    pace.begin(GapStage.RIVALS)
    assert told[-1].left_s == pytest.approx(10.0)
    watch.now = 130.0
    pace.advance()
    assert told[-1].left_s == 0.0


def test_a_flight_is_asked_first_and_ends_in_time() -> None:
    watch = Watch()
    pace = GapPace(watch, 100.0)
    pace.begin(GapStage.AIRFRAME)
    assert pace.share == 0.0
    watch.now = 29.0
    assert not pace.ends()
    watch.now = 31.0
    assert pace.ends()
    assert list(pace.left_out) == [GapStage.AIRFRAME]


@pytest.mark.parametrize(
    ("stage", "verdict", "said"),
    [
        (GapStage.AIRFRAME, GapVerdict.NO_GAP, GapVerdict.NOT_TESTABLE),
        (GapStage.SELECTION, GapVerdict.NO_GAP, GapVerdict.NOT_TESTABLE),
        (GapStage.RIVALS, GapVerdict.NO_GAP, GapVerdict.NOT_TESTABLE),
        (GapStage.AIRFRAME, GapVerdict.EXPLAINED, GapVerdict.EXPLAINED),
        (GapStage.HELD_OUT, GapVerdict.NO_GAP, GapVerdict.NO_GAP),
    ],
)
def test_no_gap_is_not_said_of_flights_that_were_not_searched(
    stage: GapStage, verdict: GapVerdict, said: GapVerdict
) -> None:
    """A thrust of 0.90 was no gap where the limit left the airframe out, a bias where rivals were not compared."""
    pace = GapPace(Watch(now=1e9), 100.0)
    pace.begin(stage)
    assert pace.ends()
    report = GapReport(inputs_of(biased()), verdict)
    assert unsearched(report, pace).verdict is said


def test_steps_go_on_inside_their_stage() -> None:
    told: list[GapProgress] = []
    pace = GapPace(on_progress=told.append)
    pace.begin(GapStage.SELECTION)
    for _ in range(50):
        pace.advance()
    pace.begin(GapStage.RIVALS)
    shares = [one.share for one in told]
    assert shares == sorted(shares)
    assert len(set(shares)) == len(shares)
    pace.advance()
    assert told[-1].share < 0.5 * (told[-2].share + 0.6)


def test_a_stage_took_until_the_next_one_began() -> None:
    watch = Watch()
    pace = GapPace(watch)
    pace.begin(GapStage.SELECTION)
    watch.now = 7.0
    assert pace.duration_of(GapStage.SELECTION) == 7.0
    pace.begin(GapStage.RIVALS)
    watch.now = 9.0
    pace.begin(GapStage.HELD_OUT)
    assert pace.duration_of(GapStage.SELECTION) == 7.0
    assert pace.duration_of(GapStage.RIVALS) == 2.0


@pytest.mark.long
def test_a_diagnosis_in_time_says_the_same_as_one_without_a_limit() -> None:
    told: list[GapProgress] = []
    free, limited = diagnosed(None, float("inf")), diagnosed(Watch(), 1.0, told)
    assert as_json(free) == as_json(limited)
    assert limited.left_out == ()
    assert list(dict.fromkeys(one.stage for one in told)) == list(GapStage)[2:]
    shares = [one.share for one in told]
    assert shares == sorted(shares)


@pytest.mark.long
def test_time_that_ends_in_the_blocks_leaves_the_answer_as_it_is() -> None:
    watch = Watch()

    def late(standing: GapProgress) -> None:
        watch.now = 0.96 if standing.stage is GapStage.BLOCKS else 0.1

    report = diagnose(biased(), pace=GapPace(watch, 1.0, late))
    whole = diagnosed(None, float("inf"))
    assert report.verdict is GapVerdict.EXPLAINED
    assert report.effects == whole.effects
    assert report.left_out == ("blocks",)
    assert report.shrink is not None
    assert not report.shrink.nested
    assert "the selection was not repeated" in report.warnings[0]


@pytest.mark.long
def test_time_that_ends_in_the_selection_gives_what_was_found_and_claims_no_more() -> None:
    watch = Watch()

    def late(standing: GapProgress) -> None:
        watch.now = 0.85 if standing.share > 0.4 else 0.1  # after the first step

    report = diagnose(biased(), pace=GapPace(watch, 1.0, late))
    assert len(report.effects) == 1
    assert report.verdict is GapVerdict.PARTLY_EXPLAINED
    assert report.left_out[:2] == ("selection", "rivals")
    assert "no time to try them all" in verdict_sentence(report)
    assert "the limit of 1 s ended the diagnosis" in report.warnings[0]


def test_no_time_at_all_is_no_answer_and_not_the_absence_of_a_gap() -> None:
    report = diagnosed(Watch(now=10.0), 1.0)
    assert report.effects == ()
    assert report.verdict is GapVerdict.NOT_TESTABLE
    assert verdict_sentence(report) == "There was no time for an answer."


@pytest.mark.long
@pytest.mark.parametrize("limit", [400.0, 800.0])
def test_no_look_at_all_rivals_is_begun_that_the_limit_does_not_leave(
    monkeypatch: pytest.MonkeyPatch, limit: float
) -> None:
    """The clock goes on with every hypothesis that is scored: noise that wanders had all scored again and again."""
    watch, score = Watch(), Contest.score

    def scored(self: Contest, *arguments: Any, **options: Any) -> ContestScore:
        watch.now += 1.0
        return score(self, *arguments, **options)

    monkeypatch.setattr(Contest, "score", scored)
    report = diagnose(biased(), pace=GapPace(watch, limit))
    assert report.left_out
    assert watch.now < 1.05 * limit


def test_a_long_step_tells_again_how_long_the_rest_takes() -> None:
    told: list[GapProgress] = []
    watch = Watch()
    pace = GapPace(watch, 100.0, told.append)
    pace.begin(GapStage.SELECTION)
    for _ in range(20):
        watch.now += 0.2
        assert not pace.ends()
    assert 5 < len(told) < 10


def test_a_verdict_that_claims_nothing_stays() -> None:
    pace = GapPace(Watch(now=1.0), 0.1)
    pace.begin(GapStage.RIVALS)
    assert pace.ends()
    for verdict in (GapVerdict.UNKNOWN, GapVerdict.REFERENCE):  # the catalogue was searched to its end
        report = with_limit(GapReport(inputs_of(biased()), verdict), pace)
        assert report.verdict is verdict
        assert as_json(report)["left_out"] == ["rivals"]
