"""``mavcal fit``: faces in files of their own, another's form, an array of C."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.converted import c_header
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Recording
from mavcal.service.cli import main

ACCELCAL = {
    "x-up": (-9.6490, 0.2225, -0.1925),
    "y-up": (0.0146, -9.5593, 0.0153),
    "z-up": (-0.0210, 0.1928, -9.9271),
    "x-down": (9.9363, 0.1840, -0.0210),
    "y-down": (0.0008, 9.9094, -0.0655),
    "z-down": (0.2828, 0.1528, 9.7232),
}

Cli = Callable[..., tuple[int, Any, str]]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    """Run a command in an empty folder: its exit code, its JSON (else its text), its stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, Any, str]:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        out = json.loads(said.out) if "--json" in arguments else said.out
        return int(ended.value.code or 0), out, said.err

    return run


@pytest.fixture
def faces(tmp_path: Path) -> list[str]:
    """Six tables of one face each, twenty samples of the published example in each, and their options."""
    arguments = []
    for label, row in ACCELCAL.items():
        lines = "".join(f"{k / 50},{row[0]},{row[1]},{row[2]}\n" for k in range(20))
        (tmp_path / f"{label}.csv").write_text("t,accel_x,accel_y,accel_z\n" + lines)
        arguments += ["--face", f"{label}={label}.csv"]
    return arguments


def test_six_faces_from_six_files_are_the_published_example(cli: Cli, faces: list[str]) -> None:
    code, document, _ = cli("fit", "accel-six-face", *faces, "--convention", "accelcal", "--json")
    assert code == 0
    assert document["native"]["A"][0][0] == pytest.approx(1.0017879105, abs=1e-9)
    assert document["native"]["b"] == pytest.approx([-0.0955688838, -0.1851535241, 0.0778741103], abs=1e-9)
    assert document["n_samples"] == 120
    _, everything, _ = cli(
        "fit", "accel-six-face", *faces, "--convention", "accelcal", "--samples", "all", "--form", "forward", "--json"
    )
    assert everything["native"]["regression"] == "forward"


def test_a_swapped_or_missing_face_is_refused(cli: Cli, faces: list[str]) -> None:
    swapped = [text.replace("x-up=x-up", "x-up=y-up").replace("y-up=y-up", "y-up=x-up") for text in faces]
    code, document, _ = cli("fit", "accel-six-face", *swapped, "--convention", "accelcal", "--json")
    assert (code, document["status"]) == (1, "refused")
    assert "not the face that its label says" in document["message"]
    code, document, _ = cli("fit", "accel-six-face", *faces[2:], "--convention", "accelcal", "--json")
    assert code == 1
    assert document["movements"]


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("x-up.csv", "--face", "x-up=x-up.csv"),
        ("--face", "x-up"),
        ("--face", "=x-up.csv"),
        ("--face", "x-up=missing.csv"),
        ("x-up.csv", "--as", "klingon"),
    ],
)
def test_wrong_use(cli: Cli, faces: list[str], arguments: tuple[str, ...]) -> None:
    code, _, err = cli("fit", "accel-six-face", *arguments)
    assert code == 2
    assert err.startswith("mavcal:")


@pytest.mark.parametrize(
    ("convention", "key"),
    [("matlab", "A"), ("ardupilot", "INS_ACCSCAL_X"), ("px4", "CAL_ACC0_XSCALE"), ("imu_tk", "T"), ("kalibr", "M")],
)
def test_another_form(cli: Cli, faces: list[str], convention: str, key: str) -> None:
    fitted = ("fit", "accel-six-face", *faces, "--convention", "accelcal", "--as", convention)
    _, document, _ = cli(*fitted, "--json")
    assert document["converted"]["convention"] == convention
    assert key in document["converted"]["values"]
    _, text, _ = cli(*fitted)
    assert f"    {key} = " in text
    if convention == "ardupilot":
        assert "left out: the rotation" in text


def test_a_refused_fit_has_no_other_form(cli: Cli, faces: list[str]) -> None:
    code, document, _ = cli("fit", "accel-six-face", *faces[2:], "--as", "matlab", "--json")
    assert code == 1
    assert "converted" not in document


def test_an_array_of_c_holds_the_correction(cli: Cli, faces: list[str], tmp_path: Path) -> None:
    code, document, err = cli(
        "fit", "accel-six-face", *faces, "--convention", "accelcal", "--export", "accel.h", "--json"
    )
    assert code == 0
    assert "accel.h" in err
    text = (tmp_path / "accel.h").read_text()
    assert "static const double accel_0[4][4] = {" in text
    rows = np.array([[float(x) for x in re.findall(r"[-+0-9.e]+", line)] for line in text.splitlines()[4:8]])
    model = document["model"]
    reading = np.array(ACCELCAL["y-up"])
    expected = np.array(model["matrix"]) @ (reading - model["offset"])
    np.testing.assert_allclose((rows @ np.append(reading, 1.0))[:3], expected, atol=1e-12)


@pytest.mark.usefixtures("faces")
def test_what_is_not_whole_is_no_array(tmp_path: Path) -> None:
    fits = METHODS["rest-reference"].run(logs.read(tmp_path / "x-up.csv"), {"samples": 10})
    with pytest.raises(InvalidInputError, match="not exported as an array"):
        c_header(fits)


EXPORTED = {
    "mag-motor": {"param": True, "h": False},
    **{name: {"param": True, "h": False} for name in ("accel-thermal", "thermal-linear", "thermal-poly")},
    **{name: {"param": False, "h": False} for name in ("allan", "rest-reference", "gyro-g-sensitivity", "mag-thermal")},
}
"""What a file of that kind can hold; both kinds hold what the other methods find."""


@pytest.mark.parametrize("ending", ["param", "parm", "params", "h"])
@pytest.mark.parametrize("name", METHODS)
def test_every_export_that_cannot_hold_the_finding_is_refused_before_anything_is_read(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, name: str, ending: str
) -> None:
    begun: list[str] = []

    def read(*_: object) -> Recording:
        begun.append(name)
        raise InvalidInputError("read")

    monkeypatch.setattr("mavcal.service.commands.fit_method.read_recording", read)
    code, said, error = cli("fit", name, "x.csv", "--export", f"out.{ending}")
    possible = EXPORTED.get(name, {}).get("h" if ending == "h" else "param", True)
    assert (code, said, begun) == (2, "", [name] if possible else [])
    assert possible or f"--export out.{ending}: {name} finds " in error


@pytest.mark.parametrize("name", ["allan", "rest-reference", "gyro-g-sensitivity", "mag-motor"])
def test_what_is_no_correction_has_no_other_form(cli: Cli, name: str) -> None:
    code, _, error = cli("fit", name, "x.csv", "--as", "px4")
    assert code == 2
    assert "has no other form" in error


def sphere(path: Path) -> None:
    """A compass turned through all directions, as a table."""
    directions = np.random.default_rng(3).normal(size=(400, 3))
    field = 48.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [12.0, -7.0, 30.0]
    rows = "".join(f"{k / 50},{x},{y},{z}\n" for k, (x, y, z) in enumerate(field))
    path.write_text("t,mag_x,mag_y,mag_z\n" + rows)


@pytest.mark.parametrize(
    ("out", "told"),
    [
        ("out.param", "does not say which autopilot"),
        ("out.txt", "a file ends in .param, .parm, .params, .h"),
        ("there/out.param", "there is no folder"),
    ],
)
def test_an_export_that_cannot_work_is_refused_before_the_fit_is_made(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str, told: str
) -> None:
    from mavcal.calib.methods.method import Method

    sphere(tmp_path / "x.csv")
    worked: list[str] = []
    monkeypatch.setattr(Method, "run_pooled", lambda method, *_: worked.append(method.name))
    code, said, error = cli("fit", "mag-ellipsoid", "x.csv", "--export", out)
    assert (code, said, worked) == (2, "", [])
    assert told in error


def test_a_fit_is_told_although_its_export_fails(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sphere(tmp_path / "x.csv")
    monkeypatch.setattr("mavcal.service.commands.fit_method.require_place", lambda _: None)
    out = tmp_path / "sub" / "out.h"
    code, document, error = cli("fit", "mag-ellipsoid", "x.csv", "--export", str(out), "--json")
    assert code == 1
    assert document["model"]["offset"] == pytest.approx([12.0, -7.0, 30.0], abs=1e-6)
    assert "cannot be written" in error
    assert "cannot be written" in document["export"]["error"]
    code, text, _ = cli("fit", "mag-ellipsoid", "x.csv", "--export", str(out))
    assert code == 1
    assert "offset_x" in text
