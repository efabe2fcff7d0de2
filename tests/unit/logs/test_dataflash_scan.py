from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.logs.dataflash import DataFlash, scan
from mavcal.calib.logs.dataflash.formats import define, read_fmt
from mavcal.calib.logs.dataflash.scan import BLOCK
from tests.examples import examples
from tests.unit.logs import dataflash_file as made

FLIGHT = made.flight(2.0, seed=1)
TALL = made.Message(90, "TALL", "QZZZ", "TimeUS,A,B,C")


def imu_rows(data: bytes) -> np.ndarray:
    """The bits of every IMU message of a log."""
    columns = DataFlash(data)["IMU"].columns("TimeUS", "I", "AccX", "GyrZ", "T")
    return np.stack(
        [column.astype(column.dtype).view(f"u{column.dtype.itemsize}").astype(np.uint64) for column in columns], 1
    )


def as_set(rows: np.ndarray) -> set[bytes]:
    return {row.tobytes() for row in rows}


class TestDefinitions:
    @pytest.mark.parametrize(
        ("length", "name", "letters", "columns"),
        [
            (13, "IMU", "Qb", "TimeUS,I"),
            (12, "I\x01U", "Qb", "TimeUS,I"),
            (12, "IMU", "Q?", "TimeUS,I"),
            (12, "", "Qb", "TimeUS,I"),
            (12, "IMU", "Qb", "TimeUS,TimeUS"),
            (12, "IMU", "Qb", "Time\x02US,I"),
        ],
    )
    def test_one_that_contradicts_itself_is_none(self, length, name, letters, columns):
        assert define(5, 12, "IMU", "Qb", "TimeUS,I") is not None
        assert define(5, length, name, letters, columns) is None

    def test_old_firmwares_misstate_their_own_columns(self):
        found = define(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format")
        assert found is not None
        assert found.columns == ("Type", "Length", "Name", "Format", "_4")

    def test_bytes_that_are_no_text(self):
        assert read_fmt(bytes([5, 12]) + b"\xff\xfe\xfd\xfc" + bytes(80)) is None


class TestScan:
    def test_every_message_of_an_undamaged_log(self):
        log = DataFlash(FLIGHT)
        assert {name: len(log[name]) for name in ("IMU", "RATE", "MAG", "ATT", "BAT", "GPS")} == {
            "IMU": 1600,
            "RATE": 800,
            "MAG": 20,
            "ATT": 20,
            "BAT": 20,
            "GPS": 20,
        }
        assert log.index.skipped == []
        assert int(log.index.counts.sum()) == sum(len(log[name]) for name in log)

    def test_only_what_is_asked_for_is_indexed(self):
        assert set(DataFlash(FLIGHT, ["MAG", "NONE"])) == {"MAG"}

    def test_blocks_join_without_a_seam(self):
        size = BLOCK // len(FLIGHT) + 2
        body = FLIGHT[len(made.head()) :]
        log = DataFlash(FLIGHT + size * body)
        assert len(log["IMU"]) == (size + 1) * 1600
        assert log.index.skipped == []
        assert np.array_equal(log["IMU"]["AccX"][-1600:], log["IMU"]["AccX"][:1600])

    def test_a_payload_that_looks_like_a_header_is_no_message(self):
        fake = made.IMU.rows(1, TimeUS=7, AccX=1e9).tobytes()
        text = made.MSG.rows(1, TimeUS=6_000_000, Message=fake[:54] + b"zzzzzzz").tobytes()
        log = DataFlash(FLIGHT + text + made.flight(1.0, seed=2)[len(made.head()) :])
        assert len(log["IMU"]) == 2400
        assert log["IMU"]["AccX"].max() < 1e8
        assert log.index.skipped == []

    @pytest.mark.parametrize("at", [0, 1, 2])
    def test_a_damaged_header_costs_its_own_message_only(self, at):
        data = bytearray(FLIGHT)
        place = int(DataFlash(FLIGHT)["IMU"].offsets[500]) + at
        data[place] ^= 0xFF
        log = DataFlash(bytes(data))
        assert len(log["IMU"]) == 1599
        assert log.index.skipped == [(place - at, 54)]

    def test_a_type_that_becomes_another_one(self):
        data = bytearray(FLIGHT)
        data[int(DataFlash(FLIGHT)["IMU"].offsets[500]) + 2] = 128  # FMT
        assert len(DataFlash(bytes(data))["IMU"]) == 1599

    def test_deleted_and_overwritten_stretches(self):
        offsets = DataFlash(FLIGHT)["IMU"].offsets
        cut = FLIGHT[: offsets[300] + 20] + FLIGHT[offsets[320] + 7 :]
        assert len(DataFlash(cut)["IMU"]) == 1600 - 21
        zeroed = FLIGHT[: offsets[300] + 20] + bytes(offsets[320] - offsets[300]) + FLIGHT[offsets[320] + 20 :]
        assert len(DataFlash(zeroed)["IMU"]) == 1600 - 21

    def test_a_cut_end_is_said(self):
        log = DataFlash(FLIGHT[:-10])
        assert len(log["GPS"]) == 19
        assert log.index.skipped == [(len(FLIGHT) - made.GPS.dtype.itemsize, made.GPS.dtype.itemsize - 10)]

    def test_a_definition_with_a_damaged_header_is_still_found(self):
        data = bytearray(FLIGHT)
        data[3 * 89] ^= 0x10  # IMU
        assert len(DataFlash(bytes(data))["IMU"]) == 1600

    def test_definitions_may_come_late(self):
        late = TALL.definition() + TALL.rows(2, TimeUS=[1, 2], A=b"x").tobytes()
        log = DataFlash(FLIGHT + late)
        assert log["TALL"]["A"].tolist() == ["x", "x"]

    def test_a_contradicting_definition_changes_nothing(self):
        other = made.Message(made.IMU.type, "IMU", "QB", "TimeUS,I").definition()
        assert np.array_equal(imu_rows(FLIGHT + other), imu_rows(FLIGHT))

    @pytest.mark.sampled
    @pytest.mark.parametrize("seed", range(3))
    def test_flips_and_cuts_cost_what_they_hit(self, seed):
        data = made.flight(100.0, seed=3)
        offsets = DataFlash(data)["IMU"].offsets
        bad, flips = made.flipped(data, 400, seed)
        bad, cuts = made.cut(bad, 10, 2000, seed)
        hit = np.zeros(len(data), dtype=int)
        hit[flips] = 1
        for start, end in cuts:
            hit[start:end] = 1
        total = np.concatenate([[0], np.cumsum(hit)])
        undamaged = total[offsets + 54] == total[offsets]
        kept = as_set(imu_rows(bad))
        lost = sum(row.tobytes() not in kept for row in imu_rows(data)[undamaged])
        assert lost <= 0.001 * undamaged.sum()

    @settings(max_examples=examples(60))
    @given(st.data())
    def test_no_bytes_can_break_it(self, data):
        content = bytearray(FLIGHT[: 89 * 9 + 4000])
        for _ in range(data.draw(st.integers(0, 8))):
            at = data.draw(st.integers(0, len(content) - 1))
            content[at : at + data.draw(st.integers(0, 200))] = data.draw(st.binary(max_size=60))
        index = scan.scan(np.frombuffer(bytes(content), np.uint8))
        found = sum(int(index.counts[number]) * form.length for number, form in index.formats.items())
        assert found + index.skipped_bytes == len(content)
