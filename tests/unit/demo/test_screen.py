"""What the demonstration says fits a terminal, and its last line can be typed as it stands."""

from __future__ import annotations

import sys

import pytest

from mavcal.service.demo.screen import DemoScreen, called


@pytest.fixture
def narrow(monkeypatch):
    """A terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    return DemoScreen()


def test_no_line_of_a_narrow_terminal_runs_over_its_edge(narrow, capsys):
    narrow.begin("Accelerometer")
    narrow.progress({"current": 3.0, "target": 6.0, "text": "turn it " * 30})
    narrow.end("20 parameters written, 18 of 20 proved on the stream", good=True)
    narrow.line("Every parameter is proved, except " + "INS_GYROFFS_X, " * 12)
    said = capsys.readouterr().err
    assert max(len(line) for part in said.split("\n") for line in part.split("\r")) < 80
    assert said.count("Accelerometer") == 3  # its bar twice, its end once


def test_a_program_on_the_path_is_called_by_its_name(tmp_path, monkeypatch):
    program = tmp_path / "mavcal"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert called(str(program)) == "mavcal"


def test_a_program_that_is_not_on_the_path_is_called_as_it_was(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert called(".venv/bin/mavcal") == ".venv/bin/mavcal"


def test_a_package_is_called_by_its_python():
    assert called("/somewhere/mavcal/__main__.py").split() == [sys.executable, "-m", "mavcal"]
