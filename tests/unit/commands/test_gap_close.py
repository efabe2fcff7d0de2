"""What `mavcal gap close` states for its help, and how it says no."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mavcal.service.cli import main
from mavcal.service.closing.loop import CONNECT
from mavcal.service.closing.mission import MissionKind
from mavcal.service.commands import gap_close


def test_help_states_what_the_code_does() -> None:
    assert gap_close.CONNECT == CONNECT
    assert tuple(MissionKind) == gap_close.MISSIONS


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--simulator", "sim {oops}"], "simulator-command", "{oops}"),
        (["--simulator", "sim {frame}"], "simulator-command", "has no {port}"),
        (["--simulator", "sim {port}", "--connect", "nowhere"], "simulator-command", "not an endpoint"),
        (["--simulator", "sim {port}", "--mission", "log"], "no-mission", "--mission standard"),
        (["--simulator", "no-such-simulator {port}"], "simulator-missing", "cannot be started"),
        (["--simulator", "sim {port}", "--work", "real.csv/inside"], "work-folder", "--work"),
    ],
)
def test_what_is_wrong_is_one_object(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    code: str,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{0.02 * k},0.1,0,-9.8\n" for k in range(200))
    (tmp_path / "real.csv").write_text(f"t,accel_x,accel_y,accel_z\n{rows}")
    with pytest.raises(SystemExit) as ended:
        main(["gap", "close", "--real", "real.csv", *arguments, "--json"])
    assert ended.value.code == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["code"] == code
    assert said in error["detail"]


@pytest.mark.parametrize(
    ("option", "value"), [("--speedup", "nan"), ("--speedup", "inf"), ("--mass", "inf"), ("--limit-s", "nan")]
)
def test_numbers_are_numbers(capsys: pytest.CaptureFixture[str], tmp_path: Path, option: str, value: str) -> None:
    work = str(tmp_path / "work")
    with pytest.raises(SystemExit) as ended:
        main(["gap", "close", "--real", "x", "--simulator", "sim {port}", "--work", work, option, value, "--json"])
    assert ended.value.code == 2
    assert (
        f"{value} is no {'number' if value == 'nan' else 'finite number'}"
        in json.loads(capsys.readouterr().out)["error"]["detail"]
    )
