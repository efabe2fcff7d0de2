"""The simulated PX4 against recordings of a real PX4 (main of 2025-10-05, simulator build).

The requests of system 250 are given to the simulated vehicle at their recorded times; it holds the parameter table of
the recordings. Rules of comparison, by message class:

* Echo: the first PARAM_VALUE of a name after a PARAM_SET, PARAM_REQUEST_READ or in a list. Same names, types, indices,
  counts and the same four bytes, in the same order; at most twice as late as the real one plus 10 ms.
* Repetition: PARAM_VALUEs that nobody asked for. The firmware repeats what is unsaved 5 to 400 ms after a change, when
  its receiver thread happens to wake. Compared as a set: the same names are repeated in the course of a recording, and
  ours come at most 0.45 s after some change.
* COMMAND_ACK, AUTOPILOT_VERSION, STATUSTEXT: same results, words and order.
* HEARTBEAT: the same sequence of states once equal neighbours are merged; number within one.
* Streams: the number between two instants within 3 % (message time runs at 0.99 of the recording's clock), the same
  steps between time stamps, means at rest within the noise of the mean.

Known differences, on purpose: the barometer's own calibration (CAL_BARO0_*) is not modelled, so its values are not
repeated after boot; `[logger]` texts and GPS_GLOBAL_ORIGIN are not sent; the hash has another polynomial; version
numbers of middleware and operating system are zero; ATTITUDE_TARGET, ALTITUDE, ESTIMATOR_STATUS and others that no
calibration reads are not streamed; duplicate ids of texts are not numbered.
"""

from __future__ import annotations

import csv
import itertools
import json
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.parameters import load_table
from mavcal.service.simvehicle.server import make_vehicle
from mavcal.service.simvehicle.vehicle import FlightController
from tests.link.replay import Heard, ReplayedFrame, heard, read_frames, replay

pytestmark = pytest.mark.shared

STATION = 250
GRAIN_S = 0.010
REPEAT_WITHIN_S = 0.45
VALUE, ACK = dialect.MAVLINK_MSG_ID_PARAM_VALUE, dialect.MAVLINK_MSG_ID_COMMAND_ACK
TEXT, VERSION = dialect.MAVLINK_MSG_ID_STATUSTEXT, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
REQUESTS = {
    dialect.MAVLINK_MSG_ID_PARAM_SET,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG,
}
CLEAN = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
SHOWN_AT_ONCE = 0.003  # s: echoes of the real firmware come within this time


@pytest.fixture(scope="module")
def captures(shared_data: Path) -> Path:
    return shared_data / "px4_captures"


def load(captures: Path, name: str) -> list[ReplayedFrame]:
    return list(read_frames(captures / f"{name}.tlog"))


def boot_time(frames: list[ReplayedFrame]) -> float:
    """Vehicle time at the recording's first frame, from the first attitude."""
    first = heard(frames[:400], 1, {dialect.MAVLINK_MSG_ID_ATTITUDE})[0]
    return float(first.received.message.time_boot_ms) / 1000.0 - first.t


def typed(h: Heard) -> float | int:
    """The value of a PARAM_VALUE in its own type, from its four bytes."""
    raw = h.received.payload[:4]
    return struct.unpack("<f" if h.received.message.param_type == 9 else "<i", raw)[0]


@pytest.fixture(scope="module")
def tables(captures: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Tables of 905 and of 902 parameters, by their number."""
    folder = tmp_path_factory.mktemp("tables")
    result = {}
    for source in ("params", "cal_applied"):
        values = heard(list(itertools.islice(read_frames(captures / f"{source}.tlog"), 9000)), 1, {VALUE})
        rows = {}
        for h in values:
            m = h.received.message
            if m.param_index != 65535:
                rows.setdefault(m.param_index, (m.param_id, repr(typed(h)), m.param_type))
        path = folder / f"{source}.csv"
        with path.open("w", newline="") as file:
            csv.writer(file).writerows(rows[i] for i in sorted(rows))
        result[len(rows)] = path
    return result


def sitl_vehicle(table: Path, **changes: object) -> FlightController:
    """One perfect IMU and one magnetometer with the simulator's noise, level, heading north."""
    config = {
        "autopilot": "px4",
        "sitl": True,
        "imu_count": 1,
        "mag_count": 1,
        "mag_external": [False, False, False],
        "mag_orientations": [0, 0, 0],
        "field_ned_ut": [21.7, 1.3, 43.0],
        "accel_noise": 0.1,
        "gyro_noise": 0.01,
        "mag_noise": 2.0,
        "temperature": 15.0,
        "imu_temperature_offsets": [0, 0, 0],
        "truth": {"accels": CLEAN, "gyros": CLEAN, "mags": CLEAN},
    }
    vehicle = make_vehicle(load_config(config | changes))
    vehicle.load_parameters(load_table(str(table)))
    return vehicle


def of_kind(messages: list[Heard], *ids: int) -> list[Heard]:
    return [h for h in messages if h.received.message.get_msgId() in ids]


def split_values(messages: list[Heard], requests: list[Heard]) -> tuple[list[Heard], list[Heard]]:
    """PARAM_VALUEs that answer a request, and those that nobody asked for."""
    echoes, repeats = [], []
    pending: list[tuple[float, str]] = []
    queue = [r for r in requests if r.received.name in ("PARAM_SET", "PARAM_REQUEST_READ")]
    listing = [r.t for r in requests if r.received.name == "PARAM_REQUEST_LIST"]
    for h in of_kind(messages, VALUE):
        while queue and queue[0].t <= h.t + 1e-6:
            r = queue.pop(0)
            pending.append((r.t, r.received.message.param_id))
        name = h.received.message.param_id
        listed = any(t <= h.t <= t + 2.0 for t in listing)
        recent = [p for p in pending if h.t - p[0] < 2 * SHOWN_AT_ONCE + GRAIN_S]
        match = next((p for p in recent if p[1] in (name, "")), None)
        if match is not None:
            pending.remove(match)
            echoes.append(h)
        elif listed:
            echoes.append(h)
        else:
            repeats.append(h)
    return echoes, repeats


def described(h: Heard, measured: tuple[str, ...]) -> tuple[object, ...]:
    """What must be equal of an echo."""
    m = h.received.message
    hidden = m.param_id == "_HASH_CHECK" or m.param_id.endswith(measured)
    return (m.param_id, m.param_type, m.param_index, m.param_count, b"" if hidden else h.received.payload[:4])


def assert_same_parameters(frames: list[ReplayedFrame], said: list[Heard], measured: tuple[str, ...] = ()) -> None:
    requests = heard(frames, STATION, REQUESTS)
    real, real_repeats = split_values(heard(frames, 1, {VALUE}), requests)
    sim, sim_repeats = split_values(said, requests)
    assert [described(h, measured) for h in sim] == [described(h, measured) for h in real]
    for a, b in zip(real, sim, strict=True):
        asked = max(r.t for r in requests if r.t <= min(a.t, b.t) + 1e-6)
        assert b.t - asked <= 2 * (a.t - asked) + GRAIN_S, (a, b)
    names = [{h.received.message.param_id for h in hs} for hs in (real_repeats, sim_repeats)]
    assert names[1] == {n for n in names[0] if not n.startswith("CAL_BARO")}


def assert_repeats_follow_changes(said: list[Heard], requests: list[Heard]) -> None:
    changes = [r.t for r in requests if r.received.name == "PARAM_SET"]
    _, repeats = split_values(said, requests)
    for h in repeats:
        assert any(0 < h.t - t < REPEAT_WITHIN_S for t in changes), h


def acknowledged(messages: list[Heard]) -> list[tuple[int, int]]:
    return [(h.received.message.command, h.received.message.result) for h in of_kind(messages, ACK)]


def texts(messages: list[Heard]) -> list[str]:
    return [t for h in of_kind(messages, TEXT) if not (t := h.received.message.text).startswith("[logger]")]


def states(messages: list[Heard]) -> list[tuple[int, int]]:
    beats = [(h.received.message.base_mode, h.received.message.system_status) for h in of_kind(messages, 0)]
    return [state for state, _ in itertools.groupby(beats)]


COMPARED = {0, 1, 22, 24, 26, 27, 29, 30, 31, 33, 36, 74, 77, 105, 116, 129, 147, 148, 245, 253}


def run(
    captures: Path, tables: dict[int, Path], name: str, table: int = 905, step: float = 0.005, **changes: object
) -> tuple[list[ReplayedFrame], list[Heard], FlightController]:
    frames = load(captures, name)
    vehicle = sitl_vehicle(tables[table], **changes)
    said = replay(vehicle, frames, STATION, max(boot_time(frames), 6.0), step, COMPARED)
    return frames, said, vehicle


@pytest.mark.long
def test_lists_begin_with_the_hash_and_a_second_list_restarts_without(captures: Path, tables: dict[int, Path]) -> None:
    frames, said, _ = run(captures, tables, "params")
    requests = heard(frames, STATION, REQUESTS)
    lists = [r.t for r in requests if r.received.name == "PARAM_REQUEST_LIST"]
    for begin, end in itertools.pairwise([*lists, 1e9]):
        both = [
            [described(h, ()) for h in of_kind(ms, VALUE) if begin < h.t < min(end, begin + 3)]
            for ms in (heard(frames, 1, {VALUE}), said)
        ]
        # The interrupted list ends where it ends; what came of it is a beginning of the whole.
        length = min(map(len, both))
        assert both[1][:length] == both[0][:length]
        assert len(both[1]) == pytest.approx(len(both[0]), rel=0.2)
    real_reads, sim_reads = (
        [described(h, ()) for h in of_kind(ms, VALUE) if 7 < h.t < 10] for ms in (heard(frames, 1, {VALUE}), said)
    )
    assert sim_reads == real_reads
    assert [h.received.name for h in of_kind(said, ACK, VERSION)] == ["AUTOPILOT_VERSION", "COMMAND_ACK"]
    real_version, sim_version = (of_kind(ms, VERSION)[0].received.message for ms in (heard(frames, 1, {VERSION}), said))
    assert sim_version.capabilities == real_version.capabilities
    assert sim_version.flight_sw_version == real_version.flight_sw_version


@pytest.mark.long
def test_writes_are_echoed_refused_and_repeated_alike(captures: Path, tables: dict[int, Path]) -> None:
    """Bytewise int32, wrong types, unlisted names, out of range, sets and commands while armed."""
    frames, said, vehicle = run(captures, tables, "set")
    real = heard(frames, 1, {VALUE, ACK, TEXT, 0})
    assert_same_parameters(frames, said)
    assert_repeats_follow_changes(said, heard(frames, STATION, REQUESTS))
    assert acknowledged(said) == acknowledged(real)
    assert texts(said) == texts(real)
    assert states(said) == states(real)
    assert vehicle.table["CAL_ACC3_ID"].value == 0


def test_not_a_number_is_accepted_and_wrecks_the_next_save(captures: Path, tables: dict[int, Path]) -> None:
    frames, said, vehicle = run(captures, tables, "set_nan_inf")
    assert_same_parameters(frames, said)
    assert acknowledged(said) == acknowledged(heard(frames, 1, {ACK}))
    for message_id in (0, 26, 30):
        real_last, sim_last = (of_kind(ms, message_id)[-1].t for ms in (heard(frames, 1, {message_id}), said))
        assert sim_last == pytest.approx(real_last, abs=1.1 if message_id == 0 else 0.1)
    assert vehicle.parameters.frozen


@pytest.mark.long
def test_a_reboot_is_refused_and_a_shutdown_restarts(captures: Path, tables: dict[int, Path]) -> None:
    frames, said, vehicle = run(captures, tables, "reboot", 902)
    real = heard(frames, 1, {VALUE, ACK, 0, 30, 26})
    assert_same_parameters(frames, said)
    assert acknowledged(said) == acknowledged(real)
    assert states(said) == states(real)
    every = [[f.t for f in frames if f.system == 1], [h.t for h in said]]
    silence = [max(b - a for a, b in itertools.pairwise(times)) for times in every]
    assert silence[1] == pytest.approx(silence[0], rel=0.25)
    back = [next(t for t in times if t > 7.2) for times in every]
    beats = [next(h.t for h in of_kind(ms, 0) if h.t > 7.2) for ms in (real, said)]
    assert beats[0] > back[0]
    assert beats[1] > back[1]
    # The message interval is gone until it is asked for again.
    scaled = [[h.t for h in of_kind(ms, 26) if 7.2 < h.t < 15.5] for ms in (real, said)]
    assert scaled == [[], []]
    # The small change of scale was read back, and is not in force.
    assert vehicle.in_force()["CAL_ACC0_YSCALE"] == 1.0
    assert vehicle.in_force()["CAL_ACC0_YOFF"] == pytest.approx(0.07)


@pytest.mark.long
def test_a_gyro_calibration_speaks_in_texts_and_writes_by_itself(captures: Path, tables: dict[int, Path]) -> None:
    frames, said, _ = run(captures, tables, "gyro_cal", step=0.02)
    real = heard(frames, 1, {VALUE, ACK, TEXT, 0})
    requests = heard(frames, STATION, REQUESTS)
    both = [split_values(ms, requests)[1] for ms in (real, said)]
    written = [
        {(h.received.message.param_id, h.received.message.param_type) for h in repeats if h.t > 6} for repeats in both
    ]
    assert written[1] == written[0]
    offsets = [
        np.array([typed(h) for h in repeats if h.received.message.param_id.endswith("OFF") and h.t > 6])
        for repeats in both
    ]
    # 250 samples of 0.01 rad/s: the mean is good to 6e-4.
    assert np.abs(offsets[0]).max() < 3e-3
    assert np.abs(offsets[1]).max() < 3e-3
    assert acknowledged(said) == acknowledged(real)
    # Two of the thirteen texts are refusals of the second request; their place among the others is chance.
    assert Counter(texts(said)) - Counter(texts(real)) == Counter()
    assert [t for t in texts(said) if "[cal]" in t] == [t for t in texts(real) if "[cal]" in t]
    done = [next(h.t for h in of_kind(ms, TEXT) if "done" in h.received.message.text) for ms in (real, said)]
    started = next(r.t for r in requests if getattr(r.received.message, "command", 0) == 241)
    assert done[1] - started <= 2 * (done[0] - started)
    assert states(said) == states(real)


@pytest.mark.long
def test_a_false_gyro_offset_is_only_overwritten_while_the_accelerometer_is_quiet(
    captures: Path, tables: dict[int, Path]
) -> None:
    """In the recording the simulator's noise (0.1 m/s² a sample) looks like motion, and the offset stays.

    The background writer compares each sample with the one that began its window; beyond 0.5 m/s² it begins again.
    Whether noise crosses that bound within a window is chance, so the outcome at this noise is not compared; with a
    quiet accelerometer it writes 5.1 s after the change, as was measured on another run of the real firmware.
    """
    frames, said, vehicle = run(captures, tables, "gyro_overwrite", step=0.02, accel_noise=0.02)
    real = heard(frames, 1, {VALUE, ACK})
    assert acknowledged(said) == acknowledged(real)
    requests = heard(frames, STATION, REQUESTS)
    asked = next(r.t for r in requests if r.received.name == "PARAM_SET")
    _, repeats = split_values(said, requests)
    overwritten = [h for h in repeats if h.received.message.param_id == "CAL_GYRO0_XOFF" and abs(typed(h)) < 0.01]
    assert 5.0 < overwritten[0].t - asked < 5.6
    assert vehicle.in_force()["CAL_GYRO0_XOFF"] == pytest.approx(0.0, abs=3e-3)


@pytest.mark.long
def test_streams_at_rest_have_the_same_rates_and_values(captures: Path, tables: dict[int, Path]) -> None:
    frames, said, _ = run(captures, tables, "rest", step=0.1)
    assert acknowledged(said) == acknowledged(heard(frames, 1, {ACK}))
    for message_id in (26, 105, 30, 31, 245, 24, 33, 36, 74, 1, 147, 29, 116, 129, 27):
        real, sim = (
            [h for h in of_kind(ms, message_id) if 2 < h.t < 30] for ms in (heard(frames, 1, {message_id}), said)
        )
        assert len(sim) == pytest.approx(len(real), rel=0.03, abs=1), message_id
    for begin, end in ((2.0, 30.0), (31.3, 34.0), (34.4, 36.0)):
        steps = []
        for ms in (heard(frames, 1, {26}), said):
            stamps = [h.received.message.time_boot_ms for h in of_kind(ms, 26) if begin < h.t < end]
            counts = Counter(b - a for a, b in itertools.pairwise(stamps))
            steps.append(sorted(k for k, n in counts.items() if n > 0.05 * len(stamps)))
        assert steps[1] == steps[0], (begin, end)
    names = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag", "temperature")
    means = [
        np.mean([[getattr(h.received.message, n) for n in names] for h in of_kind(ms, 26) if 2 < h.t < 30], axis=0)
        for ms in (heard(frames, 1, {26}), said)
    ]
    # The field is given to whole tens of mGauss, and the real one turned a little with the estimated attitude.
    assert means[1][:3] == pytest.approx(means[0][:3], abs=1.5)
    assert means[1][3:6] == pytest.approx(means[0][3:6], abs=1.5)
    assert means[1][6:9] == pytest.approx(means[0][6:9], abs=8.0)
    assert means[1][9] == means[0][9]


@pytest.mark.long
def test_small_changes_read_back_but_never_reach_the_stream(captures: Path, tables: dict[int, Path]) -> None:
    """Offsets, scales and field offsets below and above the thresholds, judged on the streams of both."""
    frames = load(captures, "cal_applied")
    vehicle = sitl_vehicle(tables[902])
    vehicle.table.store("IMU_GYRO_CAL_EN", 0)
    vehicle.table.save("IMU_GYRO_CAL_EN")
    said = replay(vehicle, frames, STATION, boot_time(frames), 0.5, {26})
    actions = [(t, name) for t, name, _ in json.loads((captures / "cal_applied.json").read_text())]
    real_all = heard(frames, 1, {26})
    columns = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
    for (begin, name), (end, _) in itertools.pairwise(actions):
        means = [
            np.mean([[getattr(h.received.message, n) for n in columns] for h in ms if begin + 0.5 < h.t < end], axis=0)
            for ms in (real_all, of_kind(said, 26))
        ]
        # 1000 samples or more of 10 mG and 10 mrad/s: four sd of the difference of two means.
        assert means[1] == pytest.approx(means[0], abs=4 * np.sqrt(2) * 10.2 / np.sqrt(950)), (begin, name)
        assert abs(means[1][0] - means[0][0]) < 2.0
