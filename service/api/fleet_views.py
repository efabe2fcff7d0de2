"""Wire models of the fleet; slopes and biases in the unit of the limit that they are compared with."""

from __future__ import annotations

from mavcal.calib.firmware.device_ids import decode_device_id
from mavcal.calib.fleet.record import BIAS_LIMITS, BiasLimit, SensorRecord, Triple
from mavcal.calib.fleet.standing import SensorStanding
from mavcal.calib.fleet.trend import DAY_S, Slope
from mavcal.calib.report import Json, to_json
from mavcal.service.api.models.fleet import FleetUnitModel, SensorRecordModel, UnitHistoryModel
from mavcal.service.fleet.view import FleetUnit


def fleet_unit_model(row: FleetUnit) -> FleetUnitModel:
    """A unit in one row."""
    return FleetUnitModel.model_validate(
        {
            "unit": row.unit,
            "href": f"api/v1/fleet/{row.unit}",
            "name": row.name,
            "tags": list(row.tags),
            "autopilot": row.autopilot,
            "firmware": row.firmware,
            "connected": row.presence is not None,
            "silent": None if row.presence is None else row.presence.silent,
            "seen_at": row.seen_at,
            "preflight": _preflight(row),
            "age_days": row.age,
            "ages": {kind.value: age for kind, age in row.ages.items()},
            "leaving": row.standing.leaving,
            "needs_recalibration": bool(row.standing.reasons),
            "reasons": row.standing.reasons,
            "sensors": [_sensor(s, row.now) for s in row.standing.sensors],
        }
    )


def unit_history_model(row: FleetUnit, records: tuple[SensorRecord, ...]) -> UnitHistoryModel:
    """A unit with everything that was measured of it."""
    return UnitHistoryModel(unit=fleet_unit_model(row), records=[_record(record) for record in records])


def _preflight(row: FleetUnit) -> Json | None:
    found = row.standing.preflight
    if found is None or row.report is None:
        return None
    summary = str(row.report.body.get("summary", ""))
    age = row.now - found.at
    return {"at": found.at, "age_s": age, "verdict": found.verdict, "summary": summary, "failed": found.failed}


def _sensor(sensor: SensorStanding, now: float) -> Json:
    newest, trend, measured = sensor.newest, sensor.trend, sensor.measured
    scale = BIAS_LIMITS[newest.sensor]
    odd = sensor.oddness
    return {
        "sensor": newest.sensor,
        "instance": newest.instance,
        "device_id": newest.device_id,
        "type": newest.type,
        "bus": _bus(newest),
        "calibrated_at": sensor.calibrated_at,
        "age_days": None if sensor.calibrated_at is None else (now - sensor.calibrated_at) / DAY_S,
        "job_id": sensor.job,
        "covered": sensor.covered,
        "bias": None if measured is None else _shown(measured.bias, scale),
        "temperature": None if measured is None else measured.temperature,
        "drift": {
            "n": trend.n,
            "unit": scale.limit.unit,
            "limit": scale.limit.value,
            "per_year": _slopes(trend.per_year, scale),
            "per_degc": _slopes(trend.per_degc, scale),
            "leaving": trend.leaving,
            "open": trend.open,
        },
        "oddness": None if odd is None else {**to_json(odd), "odd": odd.odd},
    }


def _record(record: SensorRecord) -> SensorRecordModel:
    scale = BIAS_LIMITS[record.sensor]
    plain = {name: getattr(record, name) for name in ("sensor", "instance", "device_id", "type", "at", "source")}
    plain |= {name: getattr(record, name) for name in ("source_id", "what", "applied", "proved", "temperature")}
    norm = None if record.norm is None else record.norm * scale.per_unit
    return SensorRecordModel(
        **plain,
        unit=scale.limit.unit,
        bias=_shown(record.bias, scale),
        sd=_shown(record.sd, scale),
        norm=norm,
        covered=record.covered,
    )


def _bus(record: SensorRecord) -> str:
    if not record.device_id:
        return ""
    part = decode_device_id(record.autopilot, record.sensor, record.device_id)
    return f"{part.bus or 'bus'} {part.bus_number}, address 0x{part.address:02x}"


def _shown(values: Triple | None, scale: BiasLimit) -> Triple | None:
    if values is None:
        return None
    x, y, z = (v * scale.per_unit for v in values)
    return x, y, z


def _slopes(slopes: tuple[Slope, Slope, Slope] | None, scale: BiasLimit) -> list[Slope] | None:
    if slopes is None:
        return None
    return [Slope(**{name: value * scale.per_unit for name, value in vars(slope).items()}) for slope in slopes]
