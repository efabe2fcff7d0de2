from __future__ import annotations

import hashlib
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from mavcal.calib.gap.export import Target
from mavcal.calib.recording import Sensor
from mavcal.service.commands import gap_files
from mavcal.service.commands.gap_files import (
    Remedy,
    check_exports,
    check_folders,
    read_files,
    read_frame,
    write_exports,
)
from mavcal.service.commands.output import write_file
from tests.unit.gap.export.making import airframe, effect, report

READING = {"mapping": {}, "sim_mapping": {}, "unit_accel": "g", "rate": None}


@pytest.fixture
def table(tmp_path):
    """Writes a table whose first column of numbers has this name."""

    def make(name, column="accel_x"):
        rows = "".join(f"{k / 50},0.5,0,-1\n" for k in range(60))
        (tmp_path / name).write_text(f"t,{column},accel_y,accel_z\n{rows}")
        return str(tmp_path / name)

    return make


def first(recording):
    return recording.channel(Sensor.ACCEL).values[0, 0]


def test_the_options_of_reading_are_of_every_table(table):
    real, sim, nominal, again = (table(f"{name}.csv") for name in ("real", "sim", "nominal", "again"))
    files = read_files(real, sim, [nominal, nominal], again, READING)
    assert [round(first(r) / 9.80665, 6) for r in (files.real, files.sim, *files.nominal, files.again)] == [0.5] * 5
    assert files.hashes == {
        role: hashlib.sha256(Path(path).read_bytes()).hexdigest() for role, path in (("real", real), ("sim", sim))
    }


def test_the_simulators_table_may_have_other_columns(table):
    reading = {**READING, "mapping": {"accel_x": "ax"}, "sim_mapping": {"accel_x": "sx"}}
    real, nominal = table("real.csv", "ax"), table("nominal.csv", "ax")
    files = read_files(real, table("sim.csv", "sx"), [nominal], table("again.csv", "sx"), reading)
    assert first(files.sim) == first(files.real) == first(files.nominal[0]) == first(files.again)
    plain = read_files(real, table("sim2.csv", "ax"), [], None, {**reading, "sim_mapping": {}})
    assert first(plain.sim) == first(plain.real)


def test_a_log_states_its_own_columns(table, monkeypatch):
    read = []
    monkeypatch.setattr("mavcal.calib.logs.is_table", lambda file: file.suffix == ".csv")
    monkeypatch.setattr("mavcal.calib.logs.read", lambda file, **how: read.append((file.name, set(how))))
    read_files(table("real.csv"), table("sim.bin"), [table("nominal.csv")], None, READING)
    own = {"mapping", "unit_accel", "rate"}
    assert read == [("real.csv", own), ("sim.bin", set()), ("nominal.csv", own)]


def test_what_is_not_there_is_not_read(table, tmp_path):
    files = read_files(table("real.csv"), None, [], None, READING)
    assert (files.sim, files.nominal, files.again, set(files.hashes)) == (None, (), None, {"real"})
    for role in range(1, 4):
        names = [table("real.csv"), None, [], None]
        names[role] = [str(tmp_path / "gone")] if role == 2 else str(tmp_path / "gone")
        with pytest.raises(click.BadParameter, match="there is no file"):
            read_files(*names, READING)


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("a.parm", None), ("a.param", "sitl"), ("a.sdf", None), ("a.txt", "gazebo"), ("a.m", None), ("a.json", None),
        ("a.params", None), ("a.json", "sitl"), ("a.params", "vehicle"), ("a.parm", "vehicle"),
    ],
)  # fmt: skip
def test_an_ending_or_a_target_says_whom_a_file_is_for(tmp_path, name, target):
    check_exports([tmp_path / name], target)


@pytest.mark.parametrize(
    ("name", "target", "said"), [("a.txt", None, "a.txt"), ("a.json", "vehicle", "a vehicle's file ends in")]
)
def test_a_name_that_no_export_can_have_is_refused(tmp_path, name, target, said):
    with pytest.raises(click.BadParameter, match=said):
        check_exports([tmp_path / "fine.parm", tmp_path / name], target)


def test_a_folder_that_is_not_there_is_named_before_anything_is_computed(tmp_path):
    check_folders([tmp_path / "a.html"])
    with pytest.raises(click.BadParameter, match="there is no folder"):
        check_folders([tmp_path / "a.html", tmp_path / "none" / "a.html"])


FOUND = report(effect("accel_bias", bias=(0.3, 0.0, -0.1)))


def exports(table, outs, target=None, found=FOUND, instance=1):
    files = read_files(table("real.csv"), None, [], None, READING)
    return write_exports(found, files, outs, Remedy(target, instance))


def test_the_remedy_is_written_for_each_and_told(table, tmp_path, capsys):
    outs = [tmp_path / "a.parm", tmp_path / "b.sdf"]
    written = exports(table, outs)
    assert [(one["file"], one["for"], one["written"]) for one in written] == [
        ("a.parm", Target.SITL, True),
        ("b.sdf", Target.GAZEBO, True),
    ]
    assert "SIM_ACC1_BIAS_X" in outs[0].read_text()
    said = capsys.readouterr().err
    assert f"{outs[0]}: {len(outs[0].read_text().splitlines())} lines" in said


def test_the_target_goes_before_the_ending(table, tmp_path):
    [written] = exports(table, [tmp_path / "a.txt"], "gazebo")
    assert written["for"] == "gazebo"
    assert "<mean>" in (tmp_path / "a.txt").read_text()


LIGHT = report(airframe("thrust_scale", s=0.8))


def test_the_frame_that_flew_is_what_the_remedy_builds_on(table, tmp_path):
    (tmp_path / "flown.json").write_text('# a comment\n{"mass": 2.0, "hoverThrOut": 0.4}\n')
    remedy = Remedy("sitl", mass=2.5, frame=read_frame(str(tmp_path / "flown.json")))
    files = read_files(table("real.csv"), None, [], None, READING)
    [written] = write_exports(LIGHT, files, [tmp_path / "a.json"], remedy)
    assert written["for"] == "frame"
    assert '"hoverThrOut": 0.5' in (tmp_path / "a.json").read_text()
    assert '"mass": 2.5' in (tmp_path / "a.json").read_text()


@pytest.mark.parametrize("text", ["[]", "{", '{"mass": 0}'])
def test_a_frame_that_is_none_is_refused(tmp_path, text):
    (tmp_path / "flown.json").write_text(text)
    with pytest.raises(click.BadParameter, match="the simulator's frame"):
        read_frame(str(tmp_path / "flown.json"))


def test_what_a_file_cannot_hold_or_holds_in_doubt_is_said(table, tmp_path, capsys, monkeypatch):
    made = SimpleNamespace(text="one\ntwo\n", not_held=("a delay",), doubtful=("a guess",))
    monkeypatch.setattr("mavcal.calib.gap.export.exported", lambda *_, **__: made)
    [written] = exports(table, [tmp_path / "a.parm"])
    assert (written["not_held"], written["doubtful"]) == (["a delay"], ["a guess"])
    said = capsys.readouterr().err
    assert "a.parm cannot hold a delay" in said
    assert "a.parm holds what is doubtful: a guess" in said


def test_a_file_that_cannot_be_made_is_told_and_the_others_are_written(table, tmp_path, capsys):
    outs = [tmp_path / "a.params", tmp_path / "b.parm"]
    written = [*exports(table, outs[:1], "vehicle"), *exports(table, outs[1:])]
    assert [one["written"] for one in written] == [False, True]
    assert written[0]["reason"] in capsys.readouterr().err
    assert not outs[0].exists()


def test_a_file_that_cannot_be_written_ends_the_command(tmp_path):
    with pytest.raises(click.ClickException, match="cannot be written: No such file"):
        write_file(tmp_path / "none" / "a.parm", "x")


def test_a_page_has_its_title(tmp_path, monkeypatch):
    monkeypatch.setattr("mavcal.calib.gap_report.gap_to_html", lambda _, title: f"<h1>{title}</h1>")
    gap_files.write_page(FOUND, "Gap", tmp_path / "a.html")
    assert "<h1>Gap</h1>" in (tmp_path / "a.html").read_text(encoding="utf-8")
