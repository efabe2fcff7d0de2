"""What the command line says of a gap report and of a remedy that was tried."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from mavcal.calib.airframe.geometry import NAMED
from mavcal.calib.gap.progress import DEFAULT_LIMIT_S
from mavcal.calib.gap.schema import GapVerdict, LocatedGap, NotTestable, Regime, Rival, Shrink, Unknown
from mavcal.calib.gap.verify import Left, Remainder, Size, Verified
from mavcal.service.commands import gap
from mavcal.service.commands.gap import command
from mavcal.service.commands.gap_options import FRAMES, LIMIT_S
from tests.unit.gap.export.making import effect, report
from tests.unit.gap_report.flown import DOMAINS, WEAK, WIND, drag_flight, weak_motor, windy_null

BIAS = effect("accel_bias", bias=(0.3, 0.0, -0.1))
CELL = LocatedGap("accel.x", 2, Regime("temperature", (20.0, 24.0), "degC"), 0.125, 0.5, "m/s2", 1e-9)
GONE = NotTestable("mag_delay", "There is no compass.", "a compass")


@pytest.fixture
def said(capsys):
    def of(found, verified=None):
        gap._show(found, verified)
        return capsys.readouterr().out.splitlines()

    return of


def beginning(lines, word):
    return [line for line in lines if line.startswith(word)]


def test_the_verdict_comes_first_and_the_reference_is_named(said):
    lines = said(report())
    assert lines[0].startswith(f"{report().verdict.value}:")
    assert lines[-1].startswith("reference: sim")


def test_an_effect_is_told_with_its_parameters_and_its_rivals(said):
    rival = Rival("accel_rotation", 0.9, 3.0, "turn it")
    lines = said(report(replace(BIAS, confusable_with=(rival,))))
    [first] = [number for number, line in enumerate(lines) if "(accel_bias)" in line and " 99 %" in line]
    shown = lines[first + 1 : first + 5]
    assert shown[0].split() == ["bias.x", "0.3000", "+-", "0.003", "m/s2"]
    assert "accel_rotation" in shown[3]
    assert shown[3].endswith("turn it")


def test_airframe_sensors_and_day_stand_in_groups_after_the_verdict(said):
    flight = drag_flight()
    lines = said(replace(flight, effects=(BIAS, WIND, *flight.effects)))
    assert lines[0].startswith("explained: The real vehicle flies differently from the simulated one and its sensors")
    heads = [line for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert heads[:3] == ["Airframe:", "Sensors:", "The air and the events of the day:"]
    found = [line for line in lines if line.startswith("  ") and line[2] != " "]
    assert [line.split()[0] for line in found[:4]] == ["The", "The", "a", "Wind"]
    assert "accel_bias" in found[2]


def test_sensors_alone_have_no_headings(said):
    assert "Sensors:" not in said(report(BIAS))


def test_an_effect_of_the_airframe_is_told_with_its_ratio_and_what_decides(said):
    lines = said(weak_motor())
    first = lines.index("  Motor 3 is 7.9 % weak (7.4 to 8.4)")
    told = " ".join(" ".join(line.split()) for line in lines[first + 1 : first + 7])
    assert told.startswith("motor_weak, probability 97 %; holds on held-out data")
    assert "thrust of the motor in hover: 0.921 times (0.916 to 0.926)" in told
    assert "could also be a shifted centre of gravity, 86 % alike; what decides: hover at two thrusts" in told


def test_a_doubtful_effect_of_the_airframe_says_so(said):
    guess = replace(WEAK, evidence=replace(WEAK.evidence, probability=0.4))
    [line] = [line for line in said(replace(weak_motor(), effects=(guess,))) if "motor_weak, prob" in line]
    assert "likelier" in line


def test_the_predicted_flight_is_a_table_and_what_to_fly_follows(said):
    lines = said(weak_motor())
    first = beginning(lines, "Predicted flight")[0]
    rows = lines[lines.index(first) + 1 :][:6]
    assert rows[0].split() == ["error", "before", "after", "floor"]
    assert rows[2].split()[:8] == ["velocity", "after", "1", "s,", "m/s", "0.820", "0.143", "0.100"]
    assert rows[2].endswith("94 % closed (91 to 96 %)")
    assert len({row.index(" %") for row in rows[1:]}) == 1
    assert beginning(lines, "To decide between what is left, fly:")
    assert beginning(lines, "Commands of the motors: rebuilt from RATE and MOTB at 400 Hz")
    assert not beginning(lines, "How far the gap shrinks")  # of sensors, which nothing is wrong with


@pytest.mark.parametrize("flight", [weak_motor, drag_flight, windy_null])
def test_lines_of_a_flight_fit_a_terminal(said, flight):
    lines = [line for line in said(flight())[1:] if not line.startswith("not testable")]
    assert max(map(len, lines)) <= 80


def test_no_effect_of_the_airframe_needs_the_sensor_that_it_has_not(said):
    bare = [replace(WEAK, id=name, domain=domain, params=()) for name, domain in DOMAINS.items()]
    assert "None" not in "\n".join(said(report(*bare)))


def test_how_far_the_gap_shrinks_is_said_where_there_are_effects(said):
    assert beginning(said(report(BIAS)), "How far the gap shrinks was not measured")
    shrink = Shrink(2.0, 0.5, 0.0, "declared_noise", 0.75, None, nested=True)
    assert beginning(said(replace(report(BIAS), shrink=shrink)), "On data that were held out, adding")
    assert not beginning(said(report()), "How far")


def test_what_is_not_explained_has_its_share(said):
    unknown = Unknown(flag=True, share=0.125, shape="")
    [line] = beginning(said(replace(report(BIAS), unknown=unknown)), "not explained")
    assert line == "not explained: a rest (12 % of the gap)"
    [line] = beginning(said(replace(report(), unknown=replace(unknown, shape="a ramp"))), "not explained")
    assert "a ramp" in line
    assert not beginning(said(replace(report(), unknown=replace(unknown, flag=False))), "not explained")


def test_the_worst_places_are_named_and_no_more(said):
    cells = tuple(replace(CELL, instance=k) for k in range(1, 6))
    lines = beginning(said(replace(report(BIAS), where=cells)), "where")
    assert [line.split("of instance ")[1][0] for line in lines] == ["1", "2", "3"]
    tokens = ("accel.x", "temperature 20..24", "degC", "0.5 m/s2", "0.125 nats")
    assert all(token in lines[1] for token in tokens)


@pytest.mark.parametrize(("count", "more"), [(8, 0), (9, 1)])
def test_a_long_list_of_what_is_not_testable_is_cut(said, count, more):
    lines = beginning(said(replace(report(), not_testable=(GONE,) * count)), "not testable")
    assert all("mag_delay" in line and GONE.reason in line and GONE.need in line for line in lines[:8])
    assert ["1 more" in line and "--json" in line for line in lines[8:]] == [True] * more


def test_sensors_that_were_not_compared_and_warnings_are_said(said):
    lost = NotTestable("gyro", "It is in another frame.", "the same frame")
    lines = said(replace(report(BIAS), not_testable=(lost,), warnings=("It is short.",)))
    assert lines[1].startswith("Not compared")
    assert "gyroscope" in lines[1]
    assert lines[-1].startswith("! ")


def test_a_remedy_is_told_with_what_is_left_and_what_came_in(said):
    nats = SimpleNamespace(nats=0.25, ci95=(0.2, 0.3))
    left = Left("accel_bias", (1, 2), 0.031, {}, {})
    verified = SimpleNamespace(
        remaining=nats,
        before=SimpleNamespace(nats=4.0),
        rest=SimpleNamespace(verdict=GapVerdict.PARTLY_EXPLAINED),
        effects=[left, replace(left, agrees=True)],
        added=[SimpleNamespace(id="gyro_bias")],
        warnings=("It is short.",),
    )
    lines = said(report(BIAS), verified)
    [begin] = [number for number, line in enumerate(lines) if line.startswith("with the remedy:")]
    assert all(token in lines[begin] for token in ("0.25 nats", "(0.2 to", "0.3)", "of 4;", "partly_explained"))
    left_over, agreed, added, *more = lines[begin + 1 :]
    for line in (left_over, agreed):
        assert all(token in line for token in ("accel_bias", "1, 2:", " 3.1 %"))
    assert ["its errors" in line for line in (left_over, agreed)] == [False, True]
    assert "gyro_bias" in added
    assert f"! {verified.warnings[0]}" in more


def test_a_patched_airframe_is_told_parameter_by_parameter(said):
    thrust = {"s": Remainder(0.003, 0.004, ratio=True, within=True)}
    lag = {"tau_up": Remainder(0.02, 0.004, ratio=False, within=False)}
    closed = Left("thrust_scale", (), 0.0, {}, {}, {"s": -0.1}, agrees=True, remainders=thrust)
    left = Left("motor_lag", (), 1.0, {}, {}, remainders=lag)
    before, remaining = Size(4.0, (3.0, 5.0)), Size(0.0, (0.0, 0.1))
    verified = Verified(
        same_flight=False, before=before, remaining=remaining, effects=(closed, left), added=(), rest=report(),
        warnings=(),
    )  # fmt: skip
    text = " ".join(" ".join(said(report(BIAS), verified)).split())
    assert "thrust_scale: s, real by new 1.003 ± 0.004, within two standard errors of 1" in text
    assert "tau_up, real less new 0.02 ± 0.004, not closed; the new flight does not show the effect" in text
    assert "brought nothing in" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "Missing option '--real'"),
        (("--real", "a.csv", "--export", "a.txt"), "a.txt"),
        (("--real", "a.csv", "--report", "none/a.html"), "there is no folder none"),
        (("--real", "gone.csv"), "there is no file gone.csv"),
        (("--real", "a.csv", "--limit-s", "0"), "--limit-s|not in the range"),
        (("--real", "a.csv", "--sim-map", "x"), "is not NAME=COLUMN"),
    ],
)
def test_wrong_use_is_said_before_anything_is_computed(monkeypatch, tmp_path, arguments, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mavcal.calib.gap.run", None)
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert isinstance(result.exception, click.UsageError)
    with pytest.raises(click.UsageError, match=said):
        raise result.exception


@pytest.fixture
def diagnosed(monkeypatch, tmp_path):
    """Runs the command on a table that is diagnosed so; what the diagnosis was handed."""
    file = tmp_path / "a.csv"
    file.write_text("t,accel_x,accel_y,accel_z\n" + "".join(f"{k / 50},0,0,-9.8\n" for k in range(60)))

    def run(found, *arguments):
        handed = {}

        def diagnosis(real, sim, nominal, *, inputs, pace, **stated):
            handed.update(sim=sim, nominal=nominal, inputs=inputs, limit=pace.limit_s, **stated)
            return found

        monkeypatch.setattr("mavcal.calib.gap.run", diagnosis)
        result = CliRunner().invoke(command, ["--real", str(file), *arguments], standalone_mode=False)
        assert result.exception is None
        return result, handed

    return run


@pytest.mark.parametrize(("found", "code"), [(report(BIAS), 0), (report(), 1)])
def test_the_exit_code_says_whether_anything_was_tested(diagnosed, found, code):
    result, handed = diagnosed(found, "--limit-s", "2.5")
    assert result.return_value == code
    assert (handed["sim"], handed["nominal"], set(handed["inputs"]), handed["limit"]) == (None, (), {"real"}, 2.5)
    assert result.stdout.startswith(f"{found.verdict.value}: ")


def test_a_diagnosis_may_take_as_long_as_it_takes(diagnosed):
    assert diagnosed(report(), "--limit-s", "inf")[1]["limit"] == float("inf")


def test_json_has_the_report_and_what_was_exported_and_the_page_is_written(diagnosed, tmp_path, monkeypatch):
    monkeypatch.setattr("mavcal.calib.gap_report.gap_to_html", lambda _, title: f"<h1>{title}</h1>")
    page, remedy = tmp_path / "a.html", tmp_path / "a.parm"
    result, handed = diagnosed(report(BIAS), "--report", str(page), "--export", str(remedy), "--json")
    told = json.loads(result.stdout)
    assert (told["verdict"], told["exports"][0]["file"], handed["limit"]) == ("explained", "a.parm", LIMIT_S)
    assert page.read_text() == "<h1>Sim-to-real gap of a.csv</h1>"
    assert "SIM_ACC1_BIAS_X" in remedy.read_text()


def test_help_states_what_the_diagnosis_has():
    assert LIMIT_S == DEFAULT_LIMIT_S
    assert tuple(NAMED) == FRAMES


def test_what_is_stated_of_the_airframe_reaches_the_diagnosis(diagnosed, tmp_path):
    flown = tmp_path / "flown.json"
    flown.write_text('{"hoverThrOut": 0.4}')
    _, handed = diagnosed(report(BIAS), "--frame", "hexa-x", "--mass", "2.5", "--sim-frame", str(flown))
    assert (handed["frame"], handed["mass"], handed["sim_frame"]) == ("hexa-x", 2.5, {"hoverThrOut": 0.4})


def test_a_subcommand_needs_no_recording(monkeypatch):
    monkeypatch.setattr("mavcal.calib.gap.run", None)
    result = CliRunner().invoke(command, ["selftest", "--score-only"], standalone_mode=False)
    assert isinstance(result.exception, click.UsageError)
    assert "--answers" in str(result.exception)
