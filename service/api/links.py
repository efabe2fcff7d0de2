"""Routes of links and of signing keys; none of them gives a key back."""

from __future__ import annotations

from fastapi import APIRouter

from mavcal.service.api.dependencies import MadeDep, ServiceDep
from mavcal.service.api.models.vehicles import (
    LinkModel,
    LinkRequest,
    SigningKeyModel,
    SigningKeyRequest,
    SigningRequest,
)
from mavcal.service.api.security import ADMIN, OPERATE, READ, ActorDep, SightDep
from mavcal.service.api.views import link_model
from mavcal.service.errors import LinkUnknown

router = APIRouter(tags=["links"])


@router.get("/links", operation_id="list_links", dependencies=[READ])
async def links(service: ServiceDep, sight: SightDep) -> list[LinkModel]:
    """Every open link."""
    models = [sight.link(link_model(link, service.vehicles)) for link in service.links.all()]
    return [model for model in models if model is not None]


@router.post("/links", operation_id="open_link", status_code=201, dependencies=[OPERATE])
async def open_link(body: LinkRequest, made: MadeDep, service: ServiceDep) -> LinkModel:
    """Open a link; one that is open already is returned as it is."""
    link = await service.links.open(body.url)
    made.at(f"api/v1/links/{link.id}")
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


@router.get("/signing-keys", operation_id="list_signing_keys", dependencies=[ADMIN])
async def signing_keys(service: ServiceDep) -> list[SigningKeyModel]:
    """Every signing key by name, without the key."""
    return list(await service.signing.all())


@router.post("/signing-keys", operation_id="add_signing_key", status_code=201, dependencies=[ADMIN])
async def add_signing_key(
    body: SigningKeyRequest, made: MadeDep, service: ServiceDep, actor: ActorDep
) -> SigningKeyModel:
    """Keep a signing key, or make one."""
    given = None if body.key is None else body.key.get_secret_value()
    known = await service.signing.add(body.name, given, actor)
    made.at("api/v1/signing-keys")
    return known


@router.delete("/signing-keys/{name}", operation_id="remove_signing_key", status_code=204, dependencies=[ADMIN])
async def remove_signing_key(name: str, service: ServiceDep, actor: ActorDep) -> None:
    """Forget a signing key that no open link uses."""
    await service.signing.remove(name, actor)


@router.post("/links/{link_id}/signing", operation_id="set_up_signing", dependencies=[ADMIN])
async def set_up_signing(link_id: str, body: SigningRequest, service: ServiceDep, actor: ActorDep) -> LinkModel:
    """Give the one vehicle of a link a key (SETUP_SIGNING); the link is signed once the vehicle signs with it."""
    return link_model(await service.signing.set_up(link_id, body.key, actor), service.vehicles)
