"""Uploads: readable, unreadable, hostile, too large; and the fits of them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import sqlite3
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import click
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.tlog import tlog_record
from mavcal.service.api.models.recordings import ReadingOptions
from mavcal.service.errors import DiskFull
from mavcal.service.store.sqlite import DATABASE

from .api_bench import Api, api

SPHERE = "t,mag_x,mag_y,mag_z\n"


def sphere_csv(n: int = 400, offset: tuple[float, float, float] = (20.0, -10.0, 5.0)) -> bytes:
    """A magnetometer with this offset (uT), turned in every direction."""
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(n, 3))
    values = 50.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + offset
    values += rng.normal(scale=0.05, size=values.shape)
    return (SPHERE + "".join(f"{i / 50},{x:.6f},{y:.6f},{z:.6f}\n" for i, (x, y, z) in enumerate(values))).encode()


def rest_tlog(seconds: int = 8) -> bytes:
    """An ArduPilot at rest: heartbeats and 50 Hz of RAW_IMU and SCALED_IMU2."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    rng = np.random.default_rng(6)
    records = []
    for i in range(seconds * 50):
        now = 1_700_000_000_000_000 + i * 20_000
        gx, gy, gz = rng.normal((12, -8, 5), 2.0).round().astype(int)
        messages: list[Any] = [
            mav.raw_imu_encode(1_000_000 + i * 20_000, 0, 0, -1000, int(gx), int(gy), int(gz), 200, 0, 400)
        ]
        if i % 50 == 0:
            messages.append(mav.heartbeat_encode(2, 3, 0, 0, 3))
        for message in messages:
            records.append(tlog_record(now, message.pack(mav)))
            mav.seq = (mav.seq + 1) % 256
    return b"".join(records)


async def upload(a: Api, content: bytes, expect: int = 201, *, name: str = "sphere.csv", **reading: Any) -> Any:
    params = {"name": name} | ({"reading": json.dumps(reading)} if reading else {})
    return await a.call("POST", "/api/v1/recordings", expect, params=params, content=content)


def kept(a: Api) -> list[Path]:
    return sorted((a.service.settings.data_dir / "recordings").iterdir())


async def test_a_table_is_kept_inspected_and_fitted(tmp_path):
    async with api(tmp_path) as a:
        content = sphere_csv()
        response = await a.client.post("/api/v1/recordings", params={"name": "sphere.csv"}, content=content)
        assert response.status_code == 201
        row = response.json()
        assert (row["size"], row["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
        where = urljoin(str(response.url), response.headers["location"])
        assert await a.call("GET", where, 200) == row
        assert row["inspection"]["channels"][0]["samples"] == 400
        assert row["inspection"]["source"] == "sphere.csv"
        assert await a.get("/recordings") == [row]
        assert [p.read_bytes() for p in kept(a)] == [content]
        fits = (await a.post(f"/recordings/{row['id']}/fits", {"method": "mag-sphere"}, 200))["fits"]
        assert np.allclose(fits[0]["model"]["offset"], (20, -10, 5), atol=0.05)
    async with api(tmp_path) as a:  # after a restart it is still there
        assert (await a.get("/recordings"))[0]["id"] == row["id"]


async def test_a_telemetry_log_is_read_by_its_content(tmp_path):
    async with api(tmp_path) as a:
        row = await upload(a, rest_tlog(), name="flight.bin")
        assert row["inspection"]["identity"]["autopilot"] == "ardupilot"
        fits = (await a.post(f"/recordings/{row['id']}/fits", {"method": "gyro-rest"}, 200))["fits"]
        assert np.allclose(fits[0]["model"]["offset"], (0.012, -0.008, 0.005), atol=0.001)
        assert fits[0]["relative"] is True  # no parameters were seen


async def test_reading_options_reach_the_reader(tmp_path):
    async with api(tmp_path) as a:
        content = b"1;2;3\n" * 50
        row = await upload(a, content, rate=20, mapping={"mag_x": 0, "mag_y": "1", "mag_z": "2*2"}, unit_mag="counts")
        channel = row["inspection"]["channels"][0]
        assert channel["mean"] == [1, 2, 6]
        assert channel["unit"] == "counts"
        assert channel["rate"] == pytest.approx(20)


UNREADABLE = (
    "{",
    "[]",
    "1",
    '"x"',
    "[" * 3000,
    '{"foo": 1}',
    '{"path": "/etc/passwd"}',
    '{"rate": "abc"}',
    '{"rate": -1}',
    '{"rate": NaN}',
    '{"rate": 1e999}',
    '{"rate": [1]}',
    '{"mapping": [1]}',
    '{"mapping": "mag_x=1"}',
    '{"mapping": {"mag_x": null}}',
    '{"mapping": {"mag_x": "99"}}',
    '{"mapping": {"mag_x": "mag_y*x"}}',
    '{"mapping": {"nose": "mag_y"}}',
    '{"world": "moon"}',
    '{"body": {}}',
    '{"unit_mag": "zz"}',
    '{"unit_accel": []}',
    '{"system": 300}',
    '{"system": 1}',
)


@pytest.mark.long
async def test_a_reading_option_that_makes_no_sense_is_422_and_nothing_stays(tmp_path):
    async with api(tmp_path) as a:
        for reading in UNREADABLE:
            params = {"name": "a.csv", "reading": reading}
            await a.call("POST", "/api/v1/recordings", 422, params=params, content=sphere_csv(20))
        assert kept(a) == []
        assert await a.get("/recordings") == []


GARBAGE = {
    "empty": b"",
    "words": b"this is no recording\n",
    "bytes": bytes(range(256)) * 40,
    "zip": b"PK\x03\x04" + bytes(200),
    "mat": b"MATLAB 5.0 MAT-file" + bytes(200),
    "hdf": b"\x89HDF\r\n\x1a\n" + bytes(100),
    "dataflash": b"\xa3\x95\x80" + bytes(200),
    "ulog": b"ULog\x01\x12\x35\x01" + bytes(100),
    "tlog": tlog_record(1_700_000_000_000_000, b"\xfd" + bytes(30)) * 20,
    "wide": b"," * 60000 + b"\n" + b"1," * 60000 + b"\n",
    "header only": SPHERE.encode(),
    "nan": SPHERE.encode() + b"nan,nan,nan,nan\n" * 5,
    "one cell": b"1\n",
    "utf16": SPHERE.encode("utf-16") + b"\x00",
}


@pytest.mark.long
@pytest.mark.parametrize("ending", ["csv", "tlog", "npz"])
async def test_what_is_no_recording_is_422_and_nothing_stays(tmp_path, ending):
    async with api(tmp_path) as a:
        for content in GARBAGE.values():
            problem = await upload(a, content, 422, name=f"thing.{ending}")
            words = problem["detail"].replace(".", " ").split()
            assert not any(len(word) > 15 and word.isalnum() for word in words)  # our own name of the file
        assert kept(a) == []
        assert a.service.recordings.all() == ()


NAMES = ("../../etc/x.csv", "/etc/passwd", "..", "/", ".", "a\0b.csv", "x" * 200, "a.c/sv", "é.csv")


async def test_a_name_never_leads_out_of_the_folder(tmp_path):
    async with api(tmp_path / "data") as a:
        for number, name in enumerate(NAMES, 1):
            row = await upload(a, sphere_csv(20), name=name)
            assert "/" not in row["name"], name
            assert row["name"], name
            assert [p.parent for p in kept(a)] == number * [tmp_path / "data" / "recordings"], name
            assert [p.name for p in tmp_path.iterdir()] == ["data"], name


@pytest.mark.parametrize("params", [{}, {"name": ""}, {"name": "x" * 201}])
async def test_a_name_is_needed(tmp_path, params):
    async with api(tmp_path) as a:
        problem = await a.call("POST", "/api/v1/recordings", 422, params=params, content=b"1")
        assert "name" in problem["detail"]


async def test_too_large_is_413_and_nothing_stays(tmp_path):
    async with api(tmp_path, limits={"upload_bytes": 1000}) as a:
        problem = await upload(a, sphere_csv(), 413)
        assert "1000 bytes" in problem["detail"]
        assert kept(a) == []
        await upload(a, sphere_csv(20)[:900], 201)


async def test_a_full_disk_is_507_and_nothing_stays(tmp_path, monkeypatch):
    async with api(tmp_path) as a:

        def full(_fd: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("mavcal.service.recordings.os.fsync", full)
        problem = await upload(a, sphere_csv(20), DiskFull.status_code)
        assert "Free some space" in problem["detail"]
        assert kept(a) == []


FITS: tuple[Any, ...] = (
    {"method": "nonsense"},
    {},
    {"method": 3},
    [],
    {"method": "mag-sphere", "colour": 1},
    {"method": "mag-sphere", "options": {"foo": 1}},
    {"method": "mag-sphere", "options": {"\ud800": 1}},
    {"method": "mag-sphere", "options": {"field": "north"}},
    {"method": "mag-sphere", "options": {"field": True}},
    {"method": "mag-sphere", "options": {"field": 1e999}},
    {"method": "mag-sphere", "options": {"instance": 10**400}},
    {"method": "mag-sphere", "options": {"instance": 7}},
    {"method": "mag-sphere", "options": {"instance": -1}},
    {"method": "mag-sphere", "options": {"year": 10**9}},
    {"method": "mag-ellipsoid", "options": {"robust": ["auto"]}},
    {"method": "mag-ellipsoid", "options": {"prior_sd": -1}},
    {"method": "gyro-rest"},
    {"method": "thermal-poly", "options": {"degree": 99}},
    {"method": "mag-sphere", "options": {"instance": 0.5}},
)


@pytest.mark.long
async def test_a_fit_that_cannot_be_made_is_a_problem_with_words(tmp_path):
    async with api(tmp_path) as a:
        row = await upload(a, sphere_csv(60))
        for body in FITS:
            problem = await a.post_text(f"/recordings/{row['id']}/fits", body, 422)
            assert len(problem["detail"]) > 15
            assert "extract fields" not in problem["detail"] or not isinstance(body, dict)
        await a.call("POST", "/api/v1/recordings/none/fits", 404, json={"method": "mag-sphere"})


def test_the_options_of_reading_are_those_of_the_command_line():
    from mavcal.service.commands.fit import command

    method = command.get_command(click.Context(command), "mag-sphere")
    assert method is not None
    options = {p.name for p in method.params}
    assert set(ReadingOptions.model_fields) - {"system"} <= options


async def test_a_damaged_row_is_listed_and_hides_no_other(tmp_path):
    async with api(tmp_path) as a:
        bad, good = await upload(a, sphere_csv()), await upload(a, sphere_csv())
        for body in ("{broken", '{"reading": 3, "inspection": [1]}'):
            with contextlib.closing(sqlite3.connect(a.service.settings.data_dir / DATABASE)) as database:
                database.execute("PRAGMA ignore_check_constraints = ON")  # as a damaged page would
                database.execute("UPDATE recordings SET body = ? WHERE id = ?", (body, bad["id"]))
                database.commit()
            listed = {row["id"]: row["inspection"] for row in await a.get("/recordings")}
            assert listed == {bad["id"]: {}, good["id"]: good["inspection"]}
            assert (await a.get(f"/recordings/{bad['id']}"))["name"] == "sphere.csv"
            fit = {"method": "mag-sphere", "options": {}}
            refused = await a.post(f"/recordings/{bad['id']}/fits", fit, 422)
            assert "sphere.csv" in refused["detail"]
            assert "upload the file again" in refused["detail"]
        (fitted,) = (await a.post(f"/recordings/{good['id']}/fits", fit, 200))["fits"]
        assert fitted["status"] == "ok"
