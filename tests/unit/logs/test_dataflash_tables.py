from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.dataflash import DataFlash
from tests.unit.logs import dataflash_file as made

UNIT = made.Message(80, "UNIT", "QbZ", "TimeUS,Id,Label")
MULT = made.Message(81, "MULT", "Qbd", "TimeUS,Id,Mult")
FMTU = made.Message(82, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")


def agrees(path: Path, most: int | None = None) -> int:
    """Compare every field of every message with pymavlink's reader; how many messages."""
    log = DataFlash(path)
    expected: dict[str, list] = {}
    reader = DFReader.DFReader_binary(str(path))
    while (message := reader.recv_msg()) is not None:
        expected.setdefault(message.get_type(), []).append(message)
    for name, messages in expected.items():
        table = log[name]
        assert len(table) == len(messages), name
        some = slice(None) if most is None else slice(None, None, max(1, len(messages) // most))
        for column in messages[0].get_fieldnames():
            ours = table[column][some].tolist()
            theirs = [getattr(message, column) for message in messages[some]]
            theirs = [list(value) if hasattr(value, "tolist") else value for value in theirs]
            assert np.array_equal(ours, theirs, equal_nan=not isinstance(theirs[0], (str, list))), (name, column)
    reader.close()
    return sum(map(len, expected.values()))


def test_values_are_those_of_pymavlink(tmp_path):
    path = tmp_path / "flight.bin"
    path.write_bytes(made.flight(1.0, seed=4))
    assert agrees(path) > 1200


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.parametrize("name", ["df_log171_triple_imu_mag/log171.bin", "sitl_flights/null.bin"])
def test_values_are_those_of_pymavlink_on_real_logs(shared_data, name):
    assert agrees(shared_data / name, most=300) > 90_000


def test_units_and_multipliers():
    data = made.head() + b"".join(m.definition() for m in (UNIT, MULT, FMTU))
    for letter, label in {"s": "s", "o": "m/s/s", "E": "rad/s", "#": "instance", "-": "", "G": "Gauss"}.items():
        data += UNIT.rows(1, Id=ord(letter), Label=label.encode()).tobytes()
    for letter, factor in {"-": 0.0, "F": 1e-6, "0": 1.0, "C": 1e-3, "!": 3.6}.items():
        data += MULT.rows(1, Id=ord(letter), Mult=factor).tobytes()
    data += FMTU.rows(1, FmtType=made.IMU.type, UnitIds=b"s#EEEooo", MultIds=b"F-000000").tobytes()
    data += FMTU.rows(1, FmtType=made.MAG.type, UnitIds=b"s#GGG", MultIds=b"F-CC!").tobytes()
    log = DataFlash(data + made.IMU.rows(1).tobytes() + made.MAG.rows(1).tobytes())
    assert log["IMU"].units["AccX"] == "m/s/s"
    assert log["IMU"].units["TimeUS"] == "us"
    assert "T" not in log["IMU"].units
    assert [log["MAG"].units[f"Mag{axis}"] for axis in "XYZ"] == ["mGauss", "mGauss", "3.6 Gauss"]


def test_columns_are_numpy_arrays_of_the_log_s_own_types():
    log = DataFlash(made.flight(0.2, seed=5))
    table = log["ATT"]
    assert table["TimeUS"].dtype == np.uint64
    assert table["Yaw"].dtype == np.float64
    assert table.names[0] == "TimeUS"
    assert "Roll" in table
    first = table.where(np.array([True, False]))
    assert len(first) == 1
    assert first["Yaw"][0] == table["Yaw"][0]
    assert np.array_equal(log["IMU"].arrays(("AccX", "AccY"), ("T",))[0][:, 1], log["IMU"]["AccY"])
    with pytest.raises(InvalidInputError, match="ATT has no column Nothing; it has TimeUS, DesRoll"):
        table["Nothing"]
    assert log.get("NONE") is None


@pytest.mark.parametrize("content", [b"", b"\xa3\x95\x80" + bytes(40), bytes(5000), b"PK\x03\x04" + bytes(300)])
def test_what_is_no_log_is_said_in_one_sentence(tmp_path, content):
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    with pytest.raises(UnreadableError, match=r"a\.bin"):
        DataFlash(path)


def test_a_missing_file(tmp_path):
    with pytest.raises(UnreadableError, match="cannot be opened"):
        DataFlash(tmp_path / "none.bin")
