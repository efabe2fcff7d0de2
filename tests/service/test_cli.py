"""The command line: its answers, its exit codes, and one JSON object whatever happens."""

from __future__ import annotations

import json
import logging
import os
import re
import resource
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import structlog

from mavcal.calib.methods import METHODS
from mavcal.service.cli import COMMANDS, main
from tests.patience import scaled

from .test_api_recordings import rest_tlog, sphere_csv

Cli = Callable[..., tuple[int, Any, str]]

NTARS_MAP = ("--map", "temperature=temp_c", "--unit-accel", "counts", "--unit-gyro", "counts")


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cli]:
    """Run a command in this process, in an empty folder: its exit code, its JSON (else its text), its stderr."""
    monkeypatch.chdir(tmp_path)
    handlers = len(logging.getLogger().handlers)

    def run(*arguments: str) -> tuple[int, Any, str]:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        code = 0 if ended.value.code is None else int(ended.value.code)
        return code, only_object(said.out) if "--json" in arguments else said.out, said.err

    yield run
    structlog.reset_defaults()
    for handler in logging.getLogger().handlers[handlers:]:
        logging.getLogger().removeHandler(handler)


def only_object(out: str) -> dict[str, Any]:
    """The one JSON object that stdout is."""
    document, end = json.JSONDecoder().raw_decode(out)
    assert isinstance(document, dict)
    assert out[end:].strip() == ""
    return document


def run(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "mavcal", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=scaled(100), check=False, **options)


# --- help and versions


def test_help_costs_less_than_three_tenths_of_a_second():
    best = min(processor_seconds("--help") for _ in range(4))
    assert best < 0.3


def processor_seconds(*arguments: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert run(*arguments).returncode == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize("path", [(), *((c,) for c in COMMANDS), *(("fit", m) for m in METHODS)], ids=" ".join)
def test_every_command_explains_itself(cli, path):
    code, out, _ = cli(*path, "--help")
    assert code == 0
    assert out.startswith("Usage: mavcal")
    code, short, _ = cli(*path, "-h")
    assert (code, short) == (0, out)


def test_help_lists_every_command_and_a_method_its_options(cli):
    _, out, _ = cli("--help")
    assert all(re.search(rf"^  {command} ", out, re.MULTILINE) for command in COMMANDS)
    for method in METHODS.values():
        _, out, _ = cli("fit", method.name, "--help")
        for option in method.options:
            assert f"--{option.name.replace('_', '-')}" in out
    _, out, _ = cli("config", "--help")
    assert all(word in out for word in ("show", "schema", "key"))


def test_the_version_and_nothing_at_all(cli):
    code, out, _ = cli("--version")
    assert code == 0
    assert re.fullmatch(r"mavcal, version \d+\.\d+\.\d+\n", out)
    code, out, err = cli()
    assert (code, out) == (2, "")
    assert err.startswith("Usage: mavcal")


def test_a_simulated_vehicle_explains_itself():
    done = run("simulate", "vehicle", "--help")
    assert done.returncode == 0
    assert done.stdout.startswith("Usage: mavcal simulate vehicle [OPTIONS]")
    assert "--autopilot [ardupilot|px4]" in done.stdout
    assert "--help " in done.stdout


# --- wrong use: exit code 2, one sentence on stderr, one object on stdout

WRONG: Sequence[tuple[str, ...]] = (
    ("nope",),
    ("fit",),
    ("fit", "nope", "good.csv"),
    ("fit", "mag-sphere"),
    ("fit", "mag-sphere", "missing.csv"),
    ("fit", "mag-sphere", "folder"),
    ("fit", "mag-sphere", "empty.csv"),
    ("fit", "mag-sphere", "garbage.csv"),
    ("fit", "mag-sphere", "garbage.tlog"),
    ("fit", "mag-sphere", "flight.ulg"),
    ("fit", "mag-sphere", "good.csv", "--colour", "red"),
    ("fit", "mag-sphere", "good.csv", "--field", "north"),
    ("fit", "mag-sphere", "good.csv", "--field", "nan"),
    ("fit", "mag-sphere", "good.csv", "--field", "-3"),
    ("fit", "mag-sphere", "good.csv", "--map", "mag_x"),
    ("fit", "mag-sphere", "good.csv", "--map", "nose=1"),
    ("fit", "mag-sphere", "good.csv", "--map", "mag_x=99"),
    ("fit", "mag-sphere", "good.csv", "--rate", "0"),
    ("fit", "mag-sphere", "good.csv", "--unit-mag", "furlong"),
    ("fit", "mag-ellipsoid", "good.csv", "--robust", "maybe"),
    ("fit", "gyro-rest", "good.csv"),
    ("fit", "mag-sphere", "good.csv", "--export", "out.param"),
    ("inspect",),
    ("inspect", "missing.csv"),
    ("inspect", "garbage.csv"),
    ("convert", "good.csv"),
    ("convert", "good.csv", "out.docx"),
    ("convert", "good.csv", "nowhere/out.csv"),
    ("convert", "missing.csv", "out.csv"),
    ("config", "key"),
    ("config", "key", "--name", "me", "--scope", "everything"),
    ("calibrate", "gyro"),
    ("calibrate", "gyro", "--connect", "sim:ardupilot", "--require-proof"),
    ("calibrate", "nose", "--connect", "sim:ardupilot"),
    ("calibrate", "gyro", "--connect", "bogus", "--data-dir", "data"),
    ("calibrate", "gyro", "--connect", "udpin:127.0.0.1:0", "--option", "uncertainty", "--data-dir", "data"),
    ("calibrate", "gyro", "--connect", "udpin:127.0.0.1:0", "--option", "uncertainty=small", "--data-dir", "data"),
    ("serve", "--host", "0.0.0.0", "--data-dir", "data"),
    ("serve", "--port", "99999", "--data-dir", "data"),
    ("serve", "--port", "0", "--data-dir", "good.csv"),
    ("serve", "--port", "0", "--connect", "bogus:1", "--data-dir", "data"),
    ("simulate", "recording"),
    ("demo", "--autopilot", "betaflight"),
)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "folder").mkdir()
    (tmp_path / "good.csv").write_bytes(sphere_csv(100))
    (tmp_path / "empty.csv").write_bytes(b"")
    (tmp_path / "garbage.csv").write_bytes(b"this is no recording\n")
    (tmp_path / "garbage.tlog").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "flight.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(100))
    return tmp_path


@pytest.mark.parametrize("arguments", WRONG, ids=" ".join)
def test_wrong_use_is_2_and_one_sentence(cli, files, arguments):
    code, out, err = cli(*arguments)
    assert (code, out) == (2, "")
    assert len(err.strip()) > 10
    code, document, _ = cli(*arguments, "--json")
    assert code == 2
    assert document.keys() == {"error"}
    assert document["error"]["detail"]
    assert not (files / "out.param").exists()


def test_a_file_that_may_not_be_read_is_said(cli, files, monkeypatch):
    real = Path.open

    def closed(self: Path, *given: Any, **options: Any) -> Any:
        if self.name == "good.csv":
            raise PermissionError(13, "Permission denied")
        return real(self, *given, **options)

    monkeypatch.setattr(Path, "open", closed)
    code, document, _ = cli("inspect", "good.csv", "--json")
    assert code == 2
    assert "Permission denied" in document["error"]["detail"]


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [
        ("MAVCAL_PORT", "abc", "port"),
        ("MAVCAL_CONNECT", "udpin:0.0.0.0:14550", "connect"),
        ("MAVCAL_READONLY", "1", "MAVCAL_READONLY"),
        ("MAVCAL_MAVLINK__SYSTEM", "0", "mavlink.system"),
        ("MAVCAL_MAVLINK__SIGNING_KEY", "abc", "mavlink.signing_key"),
    ],
)
def test_a_setting_that_is_wrong_is_named(cli, monkeypatch, variable, value, said):
    monkeypatch.setenv(variable, value)
    code, document, _ = cli("config", "show", "--json")
    assert code == 2
    assert said in document["error"]["detail"]


@pytest.mark.parametrize("text", ["x = [", "prot = 1", "port = 'x'", '[[api_keys]]\nname = "me"'])
def test_a_settings_file_that_is_wrong_is_said(cli, tmp_path, text):
    (tmp_path / "mavcal.toml").write_text(text)
    code, document, _ = cli("config", "show", "--json")
    assert code == 2
    assert document["error"]["detail"]


# --- the answer is no


def test_a_refused_fit_is_1_and_a_document(cli, tmp_path):
    (tmp_path / "few.csv").write_text("mag_x,mag_y,mag_z\n1,2,3\n4,5,6\n")
    code, document, _ = cli("fit", "mag-sphere", "few.csv", "--json")
    assert (code, document["status"]) == (1, "refused")
    code, out, _ = cli("fit", "mag-sphere", "few.csv")
    assert code == 1
    assert "too few" in out


def test_a_vehicle_that_is_not_there_is_1(cli):
    arguments = ("calibrate", "gyro", "--connect", "udpin:127.0.0.1:0", "--wait", "0.2", "--data-dir", "data", "--json")
    code, document, _ = cli(*arguments)
    assert code == 1
    assert document["error"]["code"] == "vehicle-silent"


# --- fits


@pytest.mark.parametrize("command", ["recover", "calibrate gyro"])
def test_a_vehicle_that_is_waited_for_is_said_with_the_reason(cli, command, monkeypatch):
    """A person who looks at a silent terminal cannot tell a wrong port from a slow radio."""
    monkeypatch.setattr("mavcal.service.commands.headless.QUIET_S", 0.05)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))  # nobody listens there
        url = f"tcp:127.0.0.1:{listener.getsockname()[1]}"
        code, _, err = cli(*command.split(), "--connect", url, "--wait", "1.5", "--data-dir", "data")
    assert code == 1
    waiting = [line for line in err.splitlines() if line.startswith(f"waiting up to 1.5 s for a vehicle on {url} (")]
    assert any("refused" in line for line in waiting), err
    assert len(waiting) == len(set(waiting))


def test_a_fit_tells_its_model_its_uncertainty_and_its_doubts(cli, files):
    code, document, _ = cli("fit", "mag-ellipsoid", "good.csv", "--json")
    assert code == 0
    assert document.keys() >= {
        *("method", "status", "message", "n_samples", "n_used", "relative", "model", "sd", "native", "residual_rms"),
        *("unit", "condition_number", "undetermined", "warnings", "quality"),
    }
    assert np.allclose(document["model"]["offset"], (20, -10, 5), atol=0.1)
    assert np.shape(document["sd"]["matrix"]) == (3, 3)
    code, out, _ = cli("fit", "mag-ellipsoid", "good.csv")
    assert code == 0
    assert "+-" in out


def test_options_reach_the_method(cli, tmp_path):
    t = np.linspace(10.0, 40.0, 200)
    rows = np.column_stack([np.arange(200) / 10, t, *(0.01 * (i + 1) * t + i for i in range(3))])
    rows[:, 2:] += np.random.default_rng(2).normal(scale=1e-3, size=(200, 3))
    np.savetxt(tmp_path / "warm.csv", rows, delimiter=",", header="t,temperature,accel_x,accel_y,accel_z", comments="")
    for tref in (0.0, 25.0):
        _, document, _ = cli("fit", "thermal-linear", "warm.csv", "--tref", str(tref), "--json")
        assert document["model"]["polynomial"]["t_ref"] == tref
    _, narrow, _ = cli("fit", "thermal-linear", "warm.csv", "--min-span", "90", "--json")
    assert narrow["status"] == "refused"


def test_a_table_goes_there_and_back(cli, files):
    _, first, _ = cli("fit", "mag-ellipsoid", "good.csv", "--json")
    assert cli("convert", "good.csv", "copy.npz", "--json")[:2] == (0, {"out": "copy.npz", "channels": 1, "raw": False})
    assert cli("convert", "copy.npz", "again.csv")[0] == 0
    _, again, _ = cli("fit", "mag-ellipsoid", "again.csv", "--json")
    assert again["model"] == first["model"]
    _, seen, _ = cli("inspect", "again.csv", "--json")
    assert seen["channels"][0]["samples"] == 100
    code, out, _ = cli("inspect", "again.csv")
    assert code == 0
    assert "mag[0]" in out


def test_what_is_relative_is_not_exported(cli, tmp_path):
    (tmp_path / "rest.tlog").write_bytes(rest_tlog())
    code, document, _ = cli("fit", "gyro-rest", "rest.tlog", "--json")
    assert (code, document["relative"]) == (0, True)
    code, document, _ = cli("fit", "gyro-rest", "rest.tlog", "--export", "out.param", "--json")
    assert code in {1, 2}
    assert document.keys() == {"error"}
    assert not (tmp_path / "out.param").exists()


@pytest.mark.shared
def test_what_a_log_with_parameters_gives_is_exported(cli, tmp_path, shared_data):
    log = str(next((shared_data / "sitl_captures").glob("*turntable*.tlog")))
    for form in ("param", "parm", "params"):
        code, document, err = cli("fit", "gyro-rest", log, "--export", f"out.{form}", "--json")
        assert code == 0, err
        text = (tmp_path / f"out.{form}").read_text()
        for name, value in zip(("INS_GYROFFS_X", "INS_GYROFFS_Y"), document["model"]["offset"], strict=False):
            (line,) = (line for line in text.splitlines() if name in line.replace(",", " ").split())
            numbers = [float(w) for w in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", line)]
            assert any(abs(number - value) < 1e-6 for number in numbers), (line, value)


# --- the tables of the specification


ACCELCAL = """accel_x,accel_y,accel_z
-9.6490,.2225,-.1925
.0146,-9.5593,.0153
-.0210,.1928,-9.9271
9.9363,.1840,-.0210
.0008,9.9094,-.0655
.2828,.1528,9.7232
"""
"""The published example of accelcal (METHODS S4), and its answer."""
ACCELCAL_A = (
    (1.0017879105, 0.0019492416, -0.0086625047),
    (0.0006320105, 1.0077751064, 0.0041462596),
    (-0.0154136555, 0.0020293504, 0.9985557849),
)
ACCELCAL_B = (-0.0955688838, -0.1851535241, 0.0778741103)


def test_six_faces_of_accelcal_give_its_digits(cli, tmp_path):
    (tmp_path / "faces.csv").write_text(ACCELCAL)
    code, document, _ = cli("fit", "accel-six-face", "faces.csv", "--convention", "accelcal", "--json")
    assert code == 0
    assert np.allclose(document["native"]["A"], ACCELCAL_A, rtol=0, atol=1e-9)
    assert np.allclose(document["native"]["b"], ACCELCAL_B, rtol=0, atol=1e-9)
    with_g = ("--convention", "accelcal", "--gravity", "9.80665", "--json")
    _, other, _ = cli("fit", "accel-six-face", "faces.csv", *with_g)
    assert other["native"]["A"][0][0] == pytest.approx(1.0014, abs=5e-5)  # the option reaches the method


@pytest.mark.shared
def test_the_table_of_the_specification_drifts_as_published(cli, shared_data):
    code, document, _ = cli(
        "fit", "thermal-linear", str(shared_data / "ntars.csv"), *NTARS_MAP, "--tref", "0", "--json"
    )
    assert code == 0
    fits = {fit["sensor"]: fit for fit in document["fits"]}
    slopes = {s: np.array(f["model"]["polynomial"]["coefficients"])[:, 0] for s, f in fits.items()}
    assert np.allclose(slopes["accel"], (6.79942, 9.19042, 3.15345), atol=6e-6)
    assert np.allclose(slopes["gyro"][:2], (0.87682, 0.46056), atol=6e-6)
    assert any("z" in name for name in fits["gyro"]["undetermined"])  # constant: named, not estimated
    assert {fit["unit"] for fit in fits.values()} == {"counts"}


@pytest.mark.shared
@pytest.mark.parametrize(
    ("file", "centre", "tolerance"),
    [
        ("mag_cuyo_qmc5883l/calibration_data__filtered_raw_data.csv", (6194.2, 248.6, 3479.8), 8.0),
        ("mag_cuyo_qmc5883l/calibration_data__noisy_raw_data.csv", (6155.0, 257.1, 3444.8), 8.0),
        ("mag_ellipsoid_fit_python/mag_out.txt", (-68.15, 82.77, -133.50), 1.0),
    ],
)
def test_the_magnetometers_of_others_have_their_known_centres(cli, shared_data, file, centre, tolerance):
    columns = ("--map", "mag_x=0,mag_y=1,mag_z=2", "--unit-mag", "counts")
    code, document, _ = cli("fit", "mag-ellipsoid", str(shared_data / file), *columns, "--json")
    assert code == 0
    assert np.abs(np.array(document["model"]["offset"]) - centre).max() < tolerance
    assert document["relative"]


# --- settings, doctor, service


def test_settings_are_shown_without_secrets(cli, monkeypatch):
    monkeypatch.setenv("MAVCAL_MAVLINK__SIGNING_KEY", "ab" * 32)
    code, document, _ = cli("config", "show", "--json")
    assert (code, document["host"]) == (0, "127.0.0.1")
    assert "abab" not in json.dumps(document)
    code, out, _ = cli("config", "show")
    assert code == 0
    assert 'host = "127.0.0.1"' in out
    code, document, _ = cli("config", "schema", "--json")
    assert (code, document["properties"]["port"]["default"]) == (0, 8765)


def test_a_key_from_the_command_line_lets_its_holder_in(cli, tmp_path):
    code, out, _ = cli("config", "key", "--name", "me", "--scope", "read", "--scope", "operate")
    assert code == 0
    (tmp_path / "mavcal.toml").write_text(out[out.index("[[api_keys]]") :])
    code, document, _ = cli("config", "show", "--json")
    assert code == 0
    assert document["api_keys"][0]["name"] == "me"
    assert sorted(document["api_keys"][0]["scopes"]) == ["operate", "read"]
    assert re.search(r"key \(shown once\): (\S+)", out)[1] not in json.dumps(document)


def test_the_doctor_finds_a_data_directory_that_cannot_be_used(cli, tmp_path, monkeypatch):
    code, document, _ = cli("doctor", "--json")
    assert code == 0
    assert {"python", "numpy", "data-dir", "port", "serial", "magnetic-model"} <= {
        f["id"] for f in document["findings"]
    }
    monkeypatch.setattr("mavcal.service.commands.doctor.DISTRIBUTIONS", ("no-such-distribution",))
    code, out, _ = cli("doctor")
    assert code == 1
    assert re.search(r"^fail +no-such-distribution", out, re.MULTILINE)


def test_serving_on_a_busy_port_says_what_to_do(cli):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        code, document, _ = cli("serve", "--port", port, "--data-dir", "data", "--json")
    assert code == 2
    assert document["error"]["code"] == "port-busy"
    assert "--port" in document["error"]["detail"]


def test_a_service_starts_answers_and_ends(tmp_path):
    command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", "0", "--data-dir", str(tmp_path / "data")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            assert ready["ready"] is True
            code = run("serve", "--port", "0", "--data-dir", str(tmp_path / "data"), "--json")
            assert code.returncode == 2
            assert only_object(code.stdout)["error"]["code"] == "data-dir-locked"
        finally:
            process.terminate()
            _, err = process.communicate(timeout=scaled(15))
    assert "Traceback" not in err
    assert process.returncode == 0


def test_a_calibration_headless_from_end_to_end(tmp_path):
    data = tmp_path / "data"
    arguments = ("calibrate", "gyro", "--connect", "sim:ardupilot?speed=20&seed=3", "--apply", "--json")
    done = run(*arguments, "--data-dir", str(data), env={**os.environ, "XDG_STATE_HOME": str(tmp_path)})
    assert done.returncode == 0, done.stderr[-2000:]
    job = only_object(done.stdout)
    assert (job["state"], job["kind"]) == ("succeeded", "gyro")
    # What the vehicle estimated at its boot may be as good as the job's result: such a gyro is left as it is.
    settled = {c["instance"] for c in job["plan"]["changes"] if c["sensor"] == "gyro"}
    assert settled | {a["instance"] for a in job["plan"]["agreements"]} == {0, 1, 2}
    checked = [] if job["verification"] is None else job["verification"]["parameters"]
    assert all(v["verdict"] in {"proved", "consistent", "not_observable"} for v in checked)
    assert "succeeded" in done.stderr
    assert (job["last_write"] or {}).get("result") == ("succeeded" if settled else None)  # nothing to write: no write
    assert f"proof: {job['outcome']['proof']}" in done.stderr
    assert all(f"{u['name']} is not proved" in done.stderr for u in job["outcome"]["unproved"])
    assert len(list((data / "tlogs").glob("*.tlog"))) == 1
