from __future__ import annotations

import os
import socket

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.recording import Sensor
from mavcal.service.commands.reading import (
    labelled_file,
    parse_mapping,
    read_recording,
    readable_file,
    reading_options,
    split_reading,
)

NAME = st.text(st.characters(codec="ascii", exclude_characters="=,", categories=["L", "N", "P"]), min_size=1)


def mapped(text):
    return parse_mapping(None, None, text)


@given(st.dictionaries(NAME, NAME), st.sampled_from(["", " "]))
def test_a_mapping_is_what_was_written(pairs, space):
    text = f",{space}".join(f"{space}{name}{space}={space}{column}{space}" for name, column in pairs.items())
    assert mapped(text) == pairs


def test_a_column_may_have_a_factor_and_a_comma_may_be_too_much():
    assert mapped("accel_x=ax*9.80665,,mag_x=3,") == {"accel_x": "ax*9.80665", "mag_x": "3"}
    assert mapped(None) == {}
    assert mapped("a=b=c") == {"a": "b=c"}


@pytest.mark.parametrize("text", ["a", "=b", "a=", " =b", "a= ", "a=1,b"])
def test_what_is_no_pair_is_named(text):
    with pytest.raises(click.BadParameter, match="is not NAME=COLUMN"):
        mapped(text)


def test_faces_keep_their_order_and_a_path_may_hold_an_equals_sign():
    values = ("x-up=first.csv", " y-up = a=b.csv ", "x-up=again.csv")
    assert labelled_file(None, None, values) == (
        ("x-up", "first.csv"),
        ("y-up", "a=b.csv"),
        ("x-up", "again.csv"),
    )


@pytest.mark.parametrize("value", ["x-up", "=first.csv", "x-up=", "  =  "])
def test_what_is_no_face_is_named(value):
    with pytest.raises(click.BadParameter, match="is not LABEL=FILE"):
        labelled_file(None, None, ("x-up=first.csv", value))


@pytest.fixture
def table(tmp_path):
    def write(name, x):
        rows = "".join(f"{k / 50},{x},0,-9.8\n" for k in range(50))
        file = tmp_path / name
        file.write_text(f"t,accel_x,accel_y,accel_z\n{rows}")
        return str(file)

    return write


def test_one_file_is_read_as_the_options_say(table):
    recording = read_recording(table("a.csv", 0.5), (), {"unit_accel": "g"})
    assert recording.channel(Sensor.ACCEL).values[0, 0] == pytest.approx(0.5 * 9.80665)


def test_several_faces_are_one_recording_with_their_labels(table):
    faces = [("x-up", table("a.csv", 1.0)), ("x-down", table("b.csv", -1.0))]
    recording = read_recording(None, faces, {})
    assert [segment.label for segment in recording.segments] == ["x-up", "x-down"]
    assert sorted(set(recording.channel(Sensor.ACCEL).values[:, 0])) == [-1.0, 1.0]


@pytest.mark.parametrize(("file", "faces"), [(None, ()), ("a.csv", (("x-up", "b.csv"),))])
def test_a_file_or_faces_and_not_both(file, faces):
    with pytest.raises(click.UsageError, match="either one FILE, or --face"):
        read_recording(file, faces, {})


def test_what_is_no_file_is_named_by_what_it_is_and_never_opened(tmp_path):
    (tmp_path / "a").touch()
    assert readable_file(str(tmp_path / "a")) == tmp_path / "a"
    os.mkfifo(tmp_path / "pipe.bin")
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(str(tmp_path / "s"))
        for path, says in (
            (tmp_path / "b", "there is no file"),
            (tmp_path, "is a folder"),
            (tmp_path / "pipe.bin", "is a pipe"),
            (tmp_path / "s", "is a socket"),
            ("/dev/null", "is a device"),
        ):
            with pytest.raises(click.BadParameter, match=says):
                readable_file(str(path))


def test_the_options_of_reading_are_told_from_those_of_the_method():
    @click.command()
    @reading_options
    def command(**_):
        pass

    own = {parameter.name for parameter in command.params}
    reading, rest = split_reading({**dict.fromkeys(own, 1), "gravity": 9.8})
    assert set(reading) == own
    assert rest == {"gravity": 9.8}
