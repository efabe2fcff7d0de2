"""Routes of the fleet."""

from __future__ import annotations

import asyncio
import time
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Query, Response
from fastapi.responses import PlainTextResponse

from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.fleet_views import fleet_unit_model, unit_history_model
from mavcal.service.api.models.fleet import FleetUnitModel, UnitHistoryModel, UnitRequest
from mavcal.service.api.security import OPERATE, READ, SightDep
from mavcal.service.api.sight import Sight
from mavcal.service.core import Service
from mavcal.service.errors import Forbidden, UnitUnknown
from mavcal.service.fleet.records import records_of_rows
from mavcal.service.fleet.table import fleet_csv
from mavcal.service.fleet.view import Choice, FleetOrder, FleetUnit, Presence, chosen, fleet_units, page_of_units

router = APIRouter(tags=["fleet"])
CSV = "text/csv"


def _choice(
    *,
    verdict: Annotated[
        list[Literal["pass", "warn", "fail", "unknown", "none"]] | None,
        Query(description="verdict of the last preflight; none: there was none; several: any of them"),
    ] = None,
    tag: Annotated[str | None, Query(max_length=40)] = None,
    min_age_days: Annotated[float | None, Query(ge=0.0, le=1e6, description="calibrated so long ago, or never")] = None,
    sensor: Annotated[
        str | None, Query(max_length=40, description="a kind (accel, gyro, mag) or a type, such as ICM-42688")
    ] = None,
    needs_recalibration: Annotated[bool | None, Query(description="whether there is a reason to calibrate")] = None,
    odd: Annotated[bool | None, Query(description="whether a sensor is unlike others of its type")] = None,
) -> Choice:
    wanted = frozenset(verdict or ())
    return Choice(wanted, tag, min_age_days, sensor, needs_recalibration, odd)


ChoiceDep = Annotated[Choice, Depends(_choice)]
Order = Literal["name", "verdict", "age", "leaving", "seen"]
"""Those of :class:`service.fleet.view.FleetOrder` (a test compares them): what the generated client spells out."""
Descending = Annotated[bool, Query(description="the largest value, or the last name, first")]


@router.get("/fleet", operation_id="list_fleet", dependencies=[READ])
async def fleet(
    response: Response,
    service: ServiceDep,
    sight: SightDep,
    choice: ChoiceDep,
    *,
    order: Order = "name",
    descending: Descending = False,
    limit: Annotated[int, Query(ge=1, le=1000, description="most rows of a page")] = 100,
    after: Annotated[str | None, Query(max_length=200, description="the last unit of the page before")] = None,
) -> list[FleetUnitModel]:
    """Every known unit, a page at a time.

    A header `Link` with `rel="next"` leads to the next page, if any.
    """
    units = await _units(service, sight)

    def made() -> tuple[list[FleetUnitModel], str | None]:
        taken = chosen(units, choice, FleetOrder(order), descending=descending)
        page, more = page_of_units(taken, after, limit)
        return [fleet_unit_model(row) for row in page], more

    models, more = await asyncio.to_thread(made)
    if more is not None:
        asked: dict[str, object] = {"order": order, "descending": str(descending).lower(), "limit": limit}
        asked |= {"verdict": sorted(choice.verdict), "tag": choice.tag, "min_age_days": choice.min_age_d}
        asked |= {"sensor": choice.sensor, "after": more}
        flags = {"needs_recalibration": choice.needs_recalibration, "odd": choice.odd}
        asked |= {name: None if flag is None else str(flag).lower() for name, flag in flags.items()}
        query = urlencode({k: v for k, v in asked.items() if v is not None}, doseq=True, errors="replace")
        response.headers["Link"] = f'<fleet?{query}>; rel="next"'
    return models


@router.get(
    "/fleet.csv",
    operation_id="export_fleet",
    dependencies=[READ],
    response_class=PlainTextResponse,
    responses={200: {"content": {CSV: {"schema": {"type": "string"}}}}},
)
async def table(
    service: ServiceDep,
    sight: SightDep,
    choice: ChoiceDep,
    *,
    order: Order = "name",
    descending: Descending = False,
) -> Response:
    """The same as a table, one row a unit, all of them."""
    units = await _units(service, sight)

    def made() -> str:
        return fleet_csv(chosen(units, choice, FleetOrder(order), descending=descending))

    headers = {"Content-Disposition": 'inline; filename="mavcal-fleet.csv"'}
    return Response(await asyncio.to_thread(made), media_type=CSV, headers=headers)


@router.get("/fleet/{unit_id}", operation_id="get_unit", dependencies=[READ])
async def unit(unit_id: str, service: ServiceDep, sight: SightDep) -> FleetUnitModel:
    """One unit."""
    return await asyncio.to_thread(fleet_unit_model, await _unit(unit_id, service, sight))


@router.patch("/fleet/{unit_id}", operation_id="change_unit", dependencies=[OPERATE])
async def change(unit_id: str, body: UnitRequest, service: ServiceDep, sight: SightDep) -> FleetUnitModel:
    """Give a unit a name, tags, or both; they stay with its hardware id."""
    if body.tags is not None and not sight.everything:
        raise Forbidden("this key is bound to tags, so it may not change any: ask with one that is not")
    found = await _unit(unit_id, service, sight)
    if found.presence is not None:
        presence = found.presence
        seen = service.store.see_unit
        await service.store.do(lambda: seen(unit_id, presence.autopilot, presence.firmware, found.now))
    await service.fleet.rename(unit_id, name=body.name, tags=body.tags)
    return await asyncio.to_thread(fleet_unit_model, await _unit(unit_id, service, sight))


@router.get("/fleet/{unit_id}/history", operation_id="get_unit_history", dependencies=[READ])
async def history(unit_id: str, service: ServiceDep, sight: SightDep) -> UnitHistoryModel:
    """Every calibration of each sensor with its numbers, and what preflights read, oldest first."""
    found = await _unit(unit_id, service, sight)
    rows = await service.store.do(lambda: service.store.fleet(unit_id))
    return await asyncio.to_thread(lambda: unit_history_model(found, records_of_rows(rows.sensors)))


async def _unit(unit_id: str, service: Service, sight: Sight) -> FleetUnit:
    for row in await _units(service, sight):
        if row.unit == unit_id:
            return row
    raise UnitUnknown(f"there is no unit {unit_id}: GET /api/v1/fleet lists them")


async def _units(service: Service, sight: Sight) -> tuple[FleetUnit, ...]:
    """Every unit that may be seen. Those that may not be seen count in comparisons, as numbers alone."""
    rows = await service.store.do(service.store.fleet)
    now = time.time()
    present = {
        v.id: Presence(v.id, v.identity.autopilot.value, v.identity.version_text, v.state.silent(v.clock()))
        for v in service.vehicles.all()
    }
    units = await asyncio.to_thread(fleet_units, rows, present, now)
    return tuple(row for row in units if sight.tagged(row.tags))
