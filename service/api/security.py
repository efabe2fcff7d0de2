"""Access control: API keys with scopes, and checks against pages in a browser on the same machine.

On loopback without keys everybody on the machine may do everything. A page from elsewhere, opened in a browser on
that machine, must not: the Host header defeats DNS rebinding, the Origin header defeats cross-site requests.

What was asked and by whom is in the audit trail, on the disk before it is done.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import secrets
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from enum import StrEnum
from ipaddress import IPv6Address, ip_address
from typing import Annotated, Any
from urllib.parse import urlsplit

import structlog
from fastapi import Depends, Request
from starlette.datastructures import Headers

from mavcal.service.api.sight import Sight
from mavcal.service.core import Service
from mavcal.service.errors import AuthError, Forbidden, StoreError, TooManyAttempts
from mavcal.service.settings import ApiKey, Settings, is_loopback

log = structlog.get_logger(__name__)

LONGEST = 2000
"""Number of characters of a request that are stored."""
NOT_KEPT = ("/recordings", "/signing-keys")
"""Endings of addresses whose requests carry a file, which is not read here, or a secret."""
COOKIE = "mavcal_key"
TICKET_S = 30.0
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_KEY = "mavcal.key"
"""Name under which a request carries its verified key."""
_PORTS = {"http": 80, "https": 443}
FAILURES_AT_ONCE = 10
"""Failures that a peer may have in quick succession."""
FAILURE_EVERY_S = 6.0
"""Time after which one further failure is allowed, s."""
MOST_PEERS = 1024


async def note(request: Request, actor: str) -> None:
    """Put a request that asks for a change into the audit trail.

    Raises
    ------
    StoreError
        If that cannot be kept. What ends something, a job or a link, is done all the same.
    """
    service: Service = request.app.state.service
    subject = _text(next(iter(request.path_params.values()), ""))
    route = request.scope["route"]
    detail: dict[str, Any] = {
        "request": f"{request.method} {_text(request.scope['path'])}",
        "request_id": request.scope.get("request_id", ""),
        "query": {_text(k): _text(v) for k, v in request.query_params.items()},
    }
    if not request.scope["path"].endswith(NOT_KEPT):
        detail["body"] = _text((await request.body()).decode("utf-8", "replace"))
    try:
        row = await service.store.do(
            lambda: service.store.add_audit(time.time(), actor, route.name.replace("_", " "), subject, detail)
        )
        log.info("audit", id=row.id, actor=actor, action=row.action, subject=subject, sha256=row.sha256)
    except StoreError as error:
        log.error("the audit trail cannot be written", actor=actor, action=route.name, reason=str(error))
        if request.method != "DELETE":
            raise


def _text(value: object) -> str:
    """`value` as valid Unicode of at most :data:`LONGEST` characters."""
    return str(value)[:LONGEST].encode("utf-8", "replace").decode()


class Scope(StrEnum):
    """Permission of a key."""

    READ = "read"
    OPERATE = "operate"  # links, jobs, answers, uploads
    WRITE_PARAMS = "write-params"  # apply and revert: what changes a vehicle
    ADMIN = "admin"


_NOTED = frozenset({Scope.OPERATE, Scope.ADMIN})
"""Scopes whose requests are audited here; the job engine itself audits changes of a vehicle."""


def digest(key: str) -> str:
    """The digest of a key, as the settings hold it."""
    return hashlib.sha256(key.encode()).hexdigest()


class RequestGuard:
    """Decides on one request; made once from the settings."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._keys: Mapping[str, ApiKey] = {key.sha256: key for key in settings.api_keys}
        self._hosts = {h.lower() for h in settings.hosts}
        self._origins = {_origin(o) for o in (*settings.allowed_origins, *settings.blueos_origins)}
        self._guests = {_origin(o) for o in settings.cors_origins}
        self._loopback_only = not settings.beyond_loopback
        self._clock = clock
        self._tickets: dict[str, tuple[float, ApiKey]] = {}
        self._throttle = Throttle(clock)

    @property
    def open(self) -> bool:
        """Whether no keys are needed."""
        return not self._keys

    def check_origin(self, method: str, headers: Headers, scheme: str = "http") -> None:
        """Refuse a rebound host name, and a change that the page of another origin asks for.

        One origin is one scheme, host and port. Programs that are no browsers send neither header. Pages of
        `cors_origins` come from another site by intent.
        """
        asked = headers.get("host", "")
        host = _hostname(f"//{asked}")
        if self._loopback_only and not (is_loopback(host) or host in self._hosts):
            raise Forbidden(f"the service is not addressed as {host!r}: add it to allowed_hosts if this name is meant")
        if method in SAFE_METHODS:
            return
        origin = headers.get("origin")
        if origin is not None and _origin(origin) in self._guests - {None}:
            return
        ours = _origin(f"{scheme}://{asked}")
        if origin is not None and _origin(origin) not in {ours, *self._origins} - {None}:
            raise Forbidden(f"a page of {origin} may not change anything here: add its origin to allowed_origins")
        if headers.get("sec-fetch-site", "none") not in {"same-origin", "none"}:
            raise Forbidden("a page of another origin may not change anything here: open the panel of this service")

    def authenticate(self, request: Request) -> ApiKey | None:
        """The key of a request, read once a request; None: no keys are set.

        Raises
        ------
        AuthError
            If there is none, or an unknown one.
        TooManyAttempts
            If this peer has given too many unknown ones.
        """
        if self.open:
            return None
        if _KEY not in request.scope:
            request.scope[_KEY] = self._authenticated(request)
        key: ApiKey = request.scope[_KEY]
        return key

    def _authenticated(self, request: Request) -> ApiKey:
        ticket = request.query_params.get("ticket") if request.method in SAFE_METHODS else None
        scheme, _, bearer = request.headers.get("authorization", "").partition(" ")
        key = bearer if scheme.lower() == "bearer" else request.cookies.get(COOKIE, "")
        if ticket is None and not key:
            raise AuthError("an API key is needed: send it as `Authorization: Bearer <key>`")
        peer = request.client.host if request.client else "unknown"
        wait_s = self._throttle.wait_s(peer)
        if wait_s > 0.0:
            raise TooManyAttempts(
                f"too many wrong keys came from {peer}: wait {math.ceil(wait_s)} s, then use a valid key",
                wait_s=wait_s,
            )
        try:
            return self._redeem(ticket) if ticket is not None else self._owner(key)
        except AuthError:
            self._throttle.failed(peer)
            log.warning("login failed", peer=peer, path=request.scope["path"][:200], ticket=ticket is not None)
            if self._throttle.wait_s(peer) > 0.0:
                log.warning("logins throttled", peer=peer)
            raise

    def _owner(self, key: str) -> ApiKey:
        given = digest(key)
        for known, owner in self._keys.items():
            if hmac.compare_digest(known, given):
                return owner
        raise AuthError("this API key is not known: send a valid one as `Authorization: Bearer <key>`")

    def ticket(self, key: ApiKey) -> str:
        """A ticket for one event stream, for browsers, whose EventSource cannot send headers."""
        now = self._clock()
        self._tickets = {t: v for t, v in self._tickets.items() if v[0] > now}
        token = secrets.token_urlsafe(24)
        self._tickets[token] = (now + TICKET_S, key)
        return token

    def _redeem(self, token: str) -> ApiKey:
        until, key = self._tickets.pop(token, (0.0, None))
        if key is None or until < self._clock():
            raise AuthError("the ticket is used or older than 30 s: ask for a new one")
        return key


def require(scope: Scope, *, noted: bool = True) -> Callable[[Request], Awaitable[None]]:
    """A dependency that lets a request pass only with `scope`; what asks for a change goes to the audit trail first.

    `noted`: False for what changes nothing but a simulation.
    """

    async def check(request: Request) -> None:
        guard: RequestGuard = request.app.state.guard
        key = guard.authenticate(request)
        if key is not None and scope not in key.scopes and Scope.ADMIN not in key.scopes:
            raise Forbidden(f"the key of {key.name!r} lacks the scope {scope.value!r}")
        if key is not None and key.tags:
            operation = getattr(request.scope["route"], "operation_id", None) or ""
            _sight(request).require(operation, request.method, request.path_params)
        if (
            noted
            and getattr(request.app.state, "noting", True)
            and scope in _NOTED
            and request.method not in SAFE_METHODS
        ):
            await note(request, _actor(request))

    return check


READ, OPERATE = Depends(require(Scope.READ)), Depends(require(Scope.OPERATE))
WRITE, ADMIN = Depends(require(Scope.WRITE_PARAMS)), Depends(require(Scope.ADMIN))
"""Dependencies of routes: the scope that a key must have."""


def _actor(request: Request) -> str:
    guard: RequestGuard = request.app.state.guard
    key = guard.authenticate(request)
    return "operator" if key is None else key.name


def _sight(request: Request) -> Sight:
    guard: RequestGuard = request.app.state.guard
    key = guard.authenticate(request)
    return Sight(request.app.state.service, () if key is None else key.tags)


SightDep = Annotated[Sight, Depends(_sight)]
"""The part of the fleet that the request's key may see."""

ActorDep = Annotated[str, Depends(_actor)]
"""Who asks, for the audit record; not for addresses that take tickets, which are good once."""


def _origin(url: str) -> tuple[str, str, int] | None:
    """Scheme, host and port; None: not the origin of a page, such as ``null``."""
    try:
        parts = urlsplit(url)
        scheme, host, port = parts.scheme.lower(), (parts.hostname or "").lower(), parts.port
    except ValueError:
        return None
    if scheme not in _PORTS or not host:
        return None
    return scheme, host, _PORTS[scheme] if port is None else port


def _hostname(url: str) -> str:
    try:
        return (urlsplit(url).hostname or "").lower()
    except ValueError:
        return ""


class Throttle:
    """Counts failed logins by peer; memory is bounded, the peer that failed longest ago is forgotten first."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._paid_until: OrderedDict[str, float] = OrderedDict()
        """Time when the last failure of a peer expires; each failure adds FAILURE_EVERY_S."""

    def wait_s(self, peer: str) -> float:
        """Seconds that this peer has to wait before its next try; 0: none."""
        paid = self._paid_until.get(_group(peer), 0.0) - self._clock()
        return max(0.0, paid - (FAILURES_AT_ONCE - 1) * FAILURE_EVERY_S)

    def failed(self, peer: str) -> None:
        """Note a failure."""
        now, group = self._clock(), _group(peer)
        self._paid_until[group] = max(self._paid_until.pop(group, now), now) + FAILURE_EVERY_S
        if len(self._paid_until) > MOST_PEERS:
            self._paid_until.popitem(last=False)

    def __len__(self) -> int:
        return len(self._paid_until)


def _group(peer: str) -> str:
    """The address of the peer, or its /64 network: one IPv6 host has all addresses of that."""
    try:
        address = ip_address(peer)
    except ValueError:
        return peer[:64]
    return str(IPv6Address(int(address) >> 64 << 64)) if isinstance(address, IPv6Address) else peer
