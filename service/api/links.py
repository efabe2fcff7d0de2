"""Routes of links."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from mavcal.service.api.addresses import relative
from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models.vehicles import LinkModel, LinkRequest
from mavcal.service.api.security import OPERATE, READ, SightDep
from mavcal.service.api.views import link_model
from mavcal.service.errors import LinkUnknown

router = APIRouter(tags=["links"])


@router.get("/links", operation_id="list_links", dependencies=[READ])
async def links(service: ServiceDep, sight: SightDep) -> list[LinkModel]:
    """Every open link."""
    models = [sight.link(link_model(link, service.vehicles)) for link in service.links.all()]
    return [model for model in models if model is not None]


@router.post("/links", operation_id="open_link", status_code=201, dependencies=[OPERATE])
async def open_link(body: LinkRequest, request: Request, response: Response, service: ServiceDep) -> LinkModel:
    """Open a link; one that is open already is returned as it is."""
    link = await service.links.open(body.url)
    response.headers["Location"] = relative(request, f"api/v1/links/{link.id}")
    return link_model(link, service.vehicles)


@router.get("/links/{link_id}", operation_id="get_link", dependencies=[READ])
async def link(link_id: str, service: ServiceDep, sight: SightDep) -> LinkModel:
    """One link."""
    model = sight.link(link_model(service.links.get(link_id), service.vehicles))
    if model is None:
        raise LinkUnknown(f"there is no link {link_id}")
    return model


@router.delete("/links/{link_id}", operation_id="close_link", status_code=204, dependencies=[OPERATE])
async def close_link(link_id: str, service: ServiceDep) -> None:
    """Close a link; its recording stays. Not while a write needs it: 409."""
    await service.close_link(link_id)
