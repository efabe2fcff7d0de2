"""Reads and writes recordings as tables: the interchange format, and foreign tables with a mapping.

One row a time stamp; an empty cell or nan means no sample then. Columns: ``t segment``; ``accel_x,y,z gyro_x,y,z
mag_x,y,z`` (a second instance is ``accel2_x`` …); ``temperature current throttle motor_1… rotor_hz_1…``;
``q_w,q_x,q_y,q_z``; and the reference: ``ref_accel_x… ref_gyro_x… ref_mag_x…`` (what an ideal sensor would have read),
``ref_q_w… ref_pos_n,e,d ref_vel_n,e,d`` (its pose). Units are those of the contract, or stated; references always have
those of the contract.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.arrays import mat_columns, npz_columns
from mavcal.calib.logs.canonical import (
    CANONICAL,
    FLIGHT,
    FRD_FROM_FLU,
    GROUP,
    REFERENCE_SI,
    SI,
    SINGLE,
    TRIADS,
    UNITS,
    column_names,
    group_names,
    ned_from_frd,
    numbered_prefix,
    reference_names,
    reference_sensor,
)
from mavcal.calib.logs.columns import TableColumns, text_columns
from mavcal.calib.logs.damaged import moving, without_zeros
from mavcal.calib.recording import Array, Channel, Event, Recording, Rounding, Segment, Sensor, Stage

MOST_BYTES = 1 << 31
"""Size of the largest table that is read."""
LARGEST = 1e15
"""Largest plausible value in any unit, above 32-bit counts and the nanoseconds of a day."""
NO_TIME = "no_time"
"""Kind of the event for a table without time, whose rows were counted."""


def read_table(
    path: Path | str,
    *,
    mapping: Mapping[str, str] | None = None,
    world: Literal["ned", "enu"] = "ned",
    body: Literal["frd", "flu"] = "frd",
    rate: float | None = None,
    unit_accel: str = "si",
    unit_gyro: str = "si",
    unit_mag: str = "uT",
) -> Recording:
    """Read a table (.csv and the like, .npz, .mat) as a recording of raw samples.

    Parameters
    ----------
    path
        The file; its kind is recognised from its content.
    mapping
        Canonical name to column, by header name or 0-based number, with an optional factor:
        ``{"accel_x": "ax*9.80665"}``; ``{"accel": "acc"}`` names the columns acc_0, acc_1, acc_2 of one array.
    world, body
        Frames of the attitudes and of the vectors in the file; the recording is north-east-down and
        forward-right-down. ``ref_pos`` and ``ref_vel`` are named by their axes and not turned.
    rate
        Samples per second where the table has no ``t``; None: one row counts as one second.
    unit_accel, unit_gyro, unit_mag
        Units of the columns, after the mapping's factors: keys of :data:`UNITS`.

    Raises
    ------
    UnreadableError
        If the file is no table, or a column is missing; the message lists what there is.
    InvalidInputError
        If an option is unknown, or time goes back.
    """
    units = _checked_units(unit_accel, unit_gyro, unit_mag)
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise InvalidInputError(f"a rate is a positive number of samples a second, not {rate}")
    if world not in {"ned", "enu"} or body not in {"frd", "flu"}:
        raise InvalidInputError(f"world is ned or enu and body frd or flu, not {world} and {body}")
    columns = read_columns(Path(path))
    table = _Table.of(columns, mapping or {})
    t, events = _time(table, columns, rate)
    beside = {"t", "segment", *(n for s, (names, _) in FLIGHT.items() if s != Sensor.ATTITUDE for n in names)}
    order = [key for key in table.cells if key not in beside and reference_sensor(key) is None]
    zeros: list[Event] = []
    channels = [
        without_zeros(channel, zeros)
        for sensor, instance in _present(order)
        if (channel := _channel(table, sensor, instance, t, units=units, body=body, world=world)) is not None
    ]
    reference = tuple(
        channel for sensor in REFERENCE_SI if (channel := _reference(table, sensor, t, body, world)) is not None
    )
    if not channels and order:
        empty = [name for name in order if not np.isfinite(table.cells[name]).any()]
        what = f"{', '.join(empty)} hold{'s' if len(empty) == 1 else ''} no number in any row"
        if not empty:
            what = f"no row has a number in all of {', '.join(order)}"
        raise UnreadableError(f"{what} (empty cells or NaN): there is nothing to read")
    if not channels:
        raise UnreadableError(
            "no column is named as a sensor (accel_x, gyro_x, mag_x, temperature ...); the table has "
            f"{columns.listed()}: name them with --map"
        )
    events += tuple(Event(float(t[0]), "damage", text) for text in (*table.damage, *_empty(table, order)))
    events += tuple(zeros)
    return Recording(
        channels=tuple(channels),
        events=events,
        segments=_segments(table, t),
        source=str(Path(path).name),
        reference=reference,
        dynamics=tuple(_of_flight(table, t, channels)),
    )


def _of_flight(table: _Table, t: Array, channels: Sequence[Channel]) -> Iterator[Channel]:
    """Flight channels of the table, as far as it has their columns."""
    for sensor, (names, unit) in FLIGHT.items():
        if sensor == Sensor.ATTITUDE:
            yield from (c for c in channels if c.sensor == sensor)
        elif all(name in table.cells for name in names):
            values, stamps = _samples(table, names, t)
            if len(stamps):
                yield Channel(sensor, 0, stamps, values, unit, Stage.RAW, "table")


def read_columns(path: Path) -> TableColumns:
    """The columns of the file, whatever kind of table it is.

    Raises
    ------
    UnreadableError
        If the file cannot be opened or is no table.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise UnreadableError(f"{path.name} has {size >> 20} MB: a table has at most {MOST_BYTES >> 20}; cut it")
        with path.open("rb") as opened:
            head = opened.read(8)
        if head[:4] == b"PK\x03\x04":
            return npz_columns(path)
        if head[:6] == b"MATLAB" or head[1:4] == b"HDF":
            return mat_columns(path)
        return text_columns(path.read_bytes())
    except OSError as error:
        raise UnreadableError(f"{path.name} cannot be opened: {error.strerror or error}") from error


def write_table(recording: Recording, path: Path | str) -> None:
    """Write the best channel of every sensor and instance and the reference as .csv or .npz, SI, one row a time stamp.

    Parameters
    ----------
    recording
        Positions, parameters and second sets of motors have no column and are left out; counts are written as counts.
    path
        Ends in ``.csv`` or ``.npz``.

    Raises
    ------
    InvalidInputError
        If the ending is another one, or there is nothing to write.
    """
    target = Path(path)
    channels = [
        recording.channel(sensor, instance)
        for sensor in SI
        for instance in recording.instances(sensor)
        if (instance == 0 or sensor in TRIADS or sensor in SINGLE)
        and any(c.stage != Stage.DEBIASED for c in recording.find(sensor, instance))
    ]
    if not channels:
        raise InvalidInputError("the recording has no samples that a table can hold")
    named = [(_written_names(channel), channel) for channel in channels]
    named += [(reference_names(c.sensor), c) for c in recording.reference if len(c) and reference_names(c.sensor)]
    t = np.unique(np.concatenate([channel.t for _, channel in named]))
    columns = {"t": t}
    for names, channel in named:
        rows = np.searchsorted(t, channel.t)
        for name, values in zip(names, channel.values.T, strict=True):
            columns[name] = np.full(len(t), np.nan)
            columns[name][rows] = values
    labels = np.full(len(t), "", dtype=object)
    for segment in recording.segments:
        labels[(t >= segment.start) & (t < segment.end)] = segment.label
    if target.suffix == ".npz":
        arrays: dict[str, Any] = {**columns, **({"segment": labels.astype(str)} if recording.segments else {})}
        np.savez(target, **arrays)
    elif target.suffix == ".csv":
        _write_csv(target, columns, labels if recording.segments else None)
    else:
        raise InvalidInputError(f"a table ends in .csv or .npz, not {target.suffix or 'nothing'}")


def _written_names(channel: Channel) -> tuple[str, ...]:
    number = "" if channel.instance == 0 else str(channel.instance + 1)
    return column_names(channel.sensor, number, channel.values.shape[1])


@dataclass(frozen=True, eq=False)
class _Table:
    """Canonical columns of the file."""

    cells: dict[str, Array]
    labels: tuple[str, ...] | None
    damage: tuple[str, ...]

    @classmethod
    def of(cls, columns: TableColumns, mapping: Mapping[str, str]) -> _Table:
        chosen: dict[str, tuple[int, float]] = {}
        for index, name in enumerate(columns.names):
            if CANONICAL.fullmatch(name.lower()):
                chosen[name.lower()] = (index, 1.0)
        for name, column in _ungrouped(columns, mapping).items():
            if not CANONICAL.fullmatch(name):
                raise InvalidInputError(
                    f"{name!r} is no column of a recording: t, segment, accel_x, gyro_x, mag_x, temperature, current, "
                    "throttle, motor_1, rotor_hz_1, q_w, ref_accel_x, ref_q_w, ref_pos_n and their like are"
                )
            wanted, factor = _factor(name, column)
            chosen[name] = (columns.index(wanted), factor)
        cells: dict[str, Array] = {}
        damage = [columns.damage]
        for name, (index, factor) in chosen.items():
            dates = _dated(columns, index) if name == "t" else None
            if dates is not None:
                cells[name] = dates
                continue
            with np.errstate(over="ignore"):
                cells[name] = columns.values[index] * factor if factor != 1.0 else columns.values[index]
            damage.append(_damage(name, columns, index))
            damage.append(_bounded(name, cells))
        labels = None
        if "segment" in chosen:
            index = chosen["segment"][0]
            labels = columns.texts.get(index) or tuple(_label(value) for value in columns.values[index])
        return cls(cells, labels, tuple(text for text in damage if text))


def _ungrouped(columns: TableColumns, mapping: Mapping[str, str]) -> dict[str, str]:
    """The mapping with every group name replaced by its columns.

    Raises
    ------
    UnreadableError
        If the table has no array of that name and width.
    """
    single: dict[str, str] = {}
    for name, column in mapping.items():
        if not GROUP.fullmatch(name):
            single[name] = column
            continue
        wanted, star, factor = column.rpartition("*")
        array = (wanted if star else column).strip()
        parts = _parts_of(columns, array)
        names = group_names(name, len(parts))
        if not names or len(names) != len(parts):
            need = f"{len(names)} columns {array}_0, {array}_1 ..." if names else f"columns {array}_0, {array}_1 ..."
            raise UnreadableError(f"{name}={column} needs {need}; the table has {columns.listed()}")
        single |= {one: f"{part}{star}{factor if star else ''}" for one, part in zip(names, parts, strict=True)}
    return single


def _parts_of(columns: TableColumns, array: str) -> list[str]:
    """The columns of an array: array_0, array_1 ..., or array_x ... where its name says what it holds."""
    numbered = [f"{array}_{k}" for k in range(len(columns.names))]
    lettered = [f"{array}_{axis}" for axis in ("wxyz" if array == "q" else "xyz")]
    return [part for part in numbered if part in columns.names] or [p for p in lettered if p in columns.names]


def _factor(name: str, column: str) -> tuple[str, float]:
    wanted, star, text = column.rpartition("*")
    if not star:
        return column.strip(), 1.0
    try:
        factor = float(text)
    except ValueError:
        raise InvalidInputError(f"{name}={column}: {text!r} is no factor; write {name}=COLUMN*9.80665") from None
    if not (np.isfinite(factor) and factor != 0.0):
        raise InvalidInputError(f"{name}={column}: a factor is finite and not zero")
    return wanted.strip(), factor


def _damage(name: str, columns: TableColumns, index: int) -> str:
    """Text on non-numeric cells of a column; empty if there are none.

    Raises
    ------
    UnreadableError
        If more than a tenth of its cells are texts.
    """
    texts = [c for c, v in zip(columns.texts.get(index, ()), columns.values[index], strict=False) if c and np.isnan(v)]
    if name == "segment" or not texts:
        return ""
    if len(texts) > 0.1 * columns.rows:
        raise UnreadableError(f"column {name} holds texts such as {texts[0]!r}: map it to a column of numbers")
    return f"{len(texts)} cells of {name} are no numbers (such as {texts[0]!r}) and were left out"


def _bounded(name: str, cells: dict[str, Array]) -> str:
    """Remove implausible numbers from `cells`; returns a text about them, empty if there are none."""
    with np.errstate(invalid="ignore"):
        wild = np.abs(cells[name]) > LARGEST
    if name == "segment" or not wild.any():
        return ""
    what = f"{int(wild.sum())} of {len(wild)} cells of {name} are infinite or beyond {LARGEST:.0e}"
    if wild.all() or name == "t":
        raise UnreadableError(f"{what}: that is no measurement")
    cells[name] = np.where(wild, np.nan, cells[name])
    return f"{what} and were left out"


def _dated(columns: TableColumns, index: int) -> Array | None:
    """Dates of a text column as seconds since the first one; None: its cells are not dates."""
    texts = columns.texts.get(index)
    if texts is None:
        return None
    try:
        dates = [datetime.fromisoformat(text.strip()) for text in texts if text.strip()]
        return np.array([(date - dates[0]).total_seconds() for date in dates]) if len(dates) == len(texts) else None
    except (ValueError, TypeError):  # no date, or zones for some of them alone
        return None


def _label(value: float) -> str:
    if not np.isfinite(value):
        return ""
    return str(int(value)) if value == int(value) else str(value)


def _time(table: _Table, columns: TableColumns, rate: float | None) -> tuple[Array, tuple[Event, ...]]:
    if "t" not in table.cells:
        t = np.arange(columns.rows) / (rate or 1.0)
        text = "the table has no time column: rows are counted, one a second; give --rate"
        return t, () if rate else (Event(0.0, NO_TIME, text),)
    t = table.cells["t"]
    if not np.isfinite(t).all():
        row = int(np.flatnonzero(~np.isfinite(t))[0])
        raise InvalidInputError(
            f"row {row + 1} of the table has no time: fill column t, or leave it out and give --rate"
        )
    stood = np.flatnonzero(~moving(t))
    if len(stood):
        row = int(stood[0])
        raise InvalidInputError(
            f"time stands still from row {row} on (at {t[row]:.6g} s, {len(stood) + 1} rows): fill column t, "
            "or leave it out and give --rate"
        )
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InvalidInputError(
            f"time goes back at row {row + 1} (from {t[row - 1]:.6g} to {t[row]:.6g} s): cut the table there, "
            "or leave t out and give --rate"
        )
    return t, ()


def _empty(table: _Table, names: list[str]) -> list[str]:
    """Columns of sensors without a single number."""
    empty = [name for name in names if not np.isfinite(table.cells[name]).any()]
    return [f"{', '.join(empty)} hold{'s' if len(empty) == 1 else ''} no number in any row"] if empty else []


def _present(names: list[str]) -> list[tuple[Sensor, int]]:
    """Sensors and instances that have a column, in a fixed order."""
    found: set[tuple[Sensor, int]] = set()
    for name in names:
        match = CANONICAL.fullmatch(name)
        assert match is not None
        if match["triad"]:
            found.add((Sensor(match["triad"]), int(match["of"] or 1) - 1))
        elif match["one"]:
            found.add((Sensor(match["one"]), int(match["nr"] or 1) - 1))
        elif match["many"]:
            found.add((Sensor.MOTOR if match["many"] == "motor" else Sensor.ROTOR_SPEED, 0))
        elif match["q"]:
            found.add((Sensor.ATTITUDE, 0))
    return sorted(found, key=lambda key: (list(SI).index(key[0]), key[1]))


def _channel(
    table: _Table, sensor: Sensor, instance: int, t: Array, *, units: Mapping[Sensor, str], body: str, world: str
) -> Channel | None:
    """The rows of that sensor that have a sample; None if none has."""
    names = _names_of(table, sensor, instance)
    values, t = _samples(table, names, t)
    if not len(values):
        return None
    unit = units.get(sensor, "si")
    values = values * UNITS.get(sensor, {}).get(unit, 1.0)
    counts = unit == "counts" and bool((values == np.round(values)).all())
    return Channel(
        sensor=sensor,
        instance=instance,
        t=t,
        values=_in_contract_frames(sensor, values, body, world),
        unit="counts" if unit == "counts" else SI[sensor],
        stage=Stage.RAW,
        source="table",
        quantum=1.0 if counts else 0.0,
        rounding=Rounding.NEAREST if counts else Rounding.NONE,
    )


def _samples(table: _Table, names: tuple[str, ...], t: Array) -> tuple[Array, Array]:
    """The rows with a number in all of the columns, and their times."""
    missing = [name for name in names if name not in table.cells]
    if missing:
        raise UnreadableError(f"{', '.join(names)} are needed together; {', '.join(missing)} is missing")
    values = np.column_stack([table.cells[name] for name in names])
    there = ~np.isnan(values).any(axis=1)
    return values[there], t[there]


def _reference(table: _Table, sensor: Sensor, t: Array, body: str, world: str) -> Channel | None:
    """The ``ref_*`` columns of that sensor; None if there are none, or none has a sample."""
    if not any(reference_sensor(name) == sensor for name in table.cells):
        return None
    values, t = _samples(table, reference_names(sensor), t)
    if not len(values):
        return None
    values = _in_contract_frames(sensor, values, body, world)
    return Channel(sensor, 0, t, values, REFERENCE_SI[sensor], Stage.RAW, "table")


def _in_contract_frames(sensor: Sensor, values: Array, body: str, world: str) -> Array:
    if sensor in TRIADS and body == "flu":
        return np.asarray(values * FRD_FROM_FLU)
    return ned_from_frd(values, body=body, world=world) if sensor == Sensor.ATTITUDE else values


def _names_of(table: _Table, sensor: Sensor, instance: int) -> tuple[str, ...]:
    numbered = instance > 0 or f"{sensor}1_x" in table.cells or f"{sensor}1" in table.cells
    prefix = numbered_prefix(sensor)
    numbers = (int(name.removeprefix(prefix)) for name in table.cells if name.startswith(prefix))
    return column_names(sensor, str(instance + 1) if numbered else "", max(numbers, default=0))


def _segments(table: _Table, t: Array) -> tuple[Segment, ...]:
    if table.labels is None or not len(t):
        return ()
    labels = table.labels
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    edges = [0, *(i for i in range(1, len(labels)) if labels[i] != labels[i - 1]), len(labels)]
    return tuple(
        Segment(labels[i], float(t[i]), float(t[j]) if j < len(t) else float(t[-1]) + (step or 1.0))
        for i, j in pairwise(edges)
        if labels[i]
    )


def _checked_units(accel: str, gyro: str, mag: str) -> dict[Sensor, str]:
    units = {Sensor.ACCEL: accel, Sensor.GYRO: gyro, Sensor.MAG: mag}
    for sensor, unit in units.items():
        if unit not in UNITS[sensor]:
            raise InvalidInputError(f"the unit of {sensor} is one of {', '.join(UNITS[sensor])}, not {unit!r}")
    return units


def _write_csv(target: Path, columns: Mapping[str, Array], labels: NDArray[np.object_] | None) -> None:
    names = [*columns, *(("segment",) if labels is not None else ())]
    with target.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for row, numbers in enumerate(zip(*(values.tolist() for values in columns.values()), strict=True)):
            cells = ["" if number != number else repr(number) for number in numbers]
            if labels is not None:
                cells.append(str(labels[row]))
            file.write(",".join(cells) + "\n")
