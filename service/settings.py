"""Settings: one tree, from keyword, environment (``MAVCAL_*``, nested with ``__``) and ``mavcal.toml``; first wins.

What may be reached from elsewhere is decided before anything listens. A list of allowed endpoints is made of words,
networks, hosts and devices.
"""

from __future__ import annotations

import ipaddress
import os
import re
import sys
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, SecretStr, model_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict, TomlConfigSettingsSource

from mavcal.service.errors import AuthError

IpNetwork = ipaddress.IPv4Network | ipaddress.IPv6Network

SERIAL, SIM, LOOPBACK, PRIVATE, ANY = "serial", "sim", "loopback", "private", "any"
DEFAULT = (SERIAL, SIM, LOOPBACK, PRIVATE)
NETWORKS = {
    LOOPBACK: ("127.0.0.0/8", "::1/128"),
    PRIVATE: ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "fc00::/7", "fe80::/10"),
    ANY: ("0.0.0.0/0", "::/0"),
}
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")
TAG = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$"
"""A tag of a vehicle."""
BLUEOS_HOSTS = ("blueos.local", "blueos-hotspot.local", "blueos-wifi.local", "192.168.2.2")
"""Under which a browser addresses BlueOS, which hands requests on to the service by a path."""
ORIGIN = r"^https?://(\[[0-9a-f:]+\]|[a-z0-9.-]+)(:[0-9]{1,5})?$"
"""One exact origin, as browsers send it; no pattern, no path."""
SIGNING_KEY = "[0-9a-fA-F]{64}"
"""A signing key as digits."""


def checked_entry(entry: str) -> str:
    """`entry` if it may stand in the list of what is allowed. Raises ValueError."""
    if entry in {SERIAL, SIM, *NETWORKS} or entry.startswith("/dev/") or network(entry) is not None:
        return entry
    if _HOST.fullmatch(entry):
        return entry.lower()
    raise ValueError(
        f"{entry!r} is none of {', '.join((*DEFAULT, ANY))}, no network as 10.1.0.0/16, no host, no /dev/…"
    )


def network(text: str) -> IpNetwork | None:
    """`text` as a network; None if it is none."""
    try:
        return ipaddress.ip_network(text, strict=False)
    except ValueError:
        return None


def default_data_dir() -> Path:
    """The platform's place for a program's state (XDG on Linux)."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "mavcal"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "mavcal"
    return Path(os.environ.get("XDG_STATE_HOME", str(Path.home() / ".local" / "state"))) / "mavcal"


def is_loopback(host: str) -> bool:
    """Whether `host` (a name or an address to bind to) can be reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ApiKey(_Part):
    """A key that may use the service, stored as a digest."""

    name: str = Field(min_length=1, description="who holds it; appears in the audit record")
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$", description="digest of the key (`mavcal config key`)")]
    scopes: frozenset[Literal["read", "operate", "write-params", "admin"]] = Field(
        default=frozenset({"read"}), description="any of `read`, `operate`, `write-params`, `admin`"
    )
    tags: frozenset[Annotated[str, Field(pattern=TAG)]] = Field(
        default=frozenset(), description="only vehicles with one of these tags are seen and touched; none: all"
    )

    @model_validator(mode="after")
    def _admin_sees_all(self) -> ApiKey:
        if self.tags and "admin" in self.scopes:
            raise ValueError("a key with the scope admin sees every vehicle: give it no tags, or other scopes")
        return self


def _absolute(path: Path) -> Path:
    return path.expanduser().absolute()


def _signing_key(key: SecretStr) -> SecretStr:
    if not re.fullmatch(SIGNING_KEY, key.get_secret_value()):
        raise ValueError("a signing key has 64 hexadecimal digits")
    return key


SigningKey = Annotated[SecretStr, AfterValidator(_signing_key)]


class MavlinkSettings(_Part):
    """Who we are on the wire."""

    system: int = Field(default=253, ge=1, le=255, description="our MAVLink system id")
    component: int = Field(
        default=190, ge=1, le=255, description="our MAVLink component id; 0 is not valid as a source"
    )
    signing_key: SigningKey | None = Field(
        default=None,
        description="signs links that name no key; 64 hexadecimal digits; none: such links are not signed",
    )
    signing_keys: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")], SigningKey] = Field(
        default_factory=dict, description="keys by name, for links that name one: `udpin:0.0.0.0:14550?signing=NAME`"
    )
    yield_s: float = Field(
        default=30.0,
        ge=10.0,
        description="a unit that was not heard for so long gives way to another one with its system id, s",
    )


class LinkSettings(_Part):
    """Which endpoints may be opened over HTTP; those of `connect` and of the command line may be any."""

    allowed: tuple[Annotated[str, AfterValidator(checked_entry)], ...] = Field(
        default=DEFAULT, description="any of `serial`, `sim`, `loopback`, `private`, `any`, networks, hosts, devices"
    )
    folders: tuple[Annotated[Path, AfterValidator(_absolute)], ...] = Field(
        default=(), description="folders whose recordings `file:` may replay, beside the service's telemetry logs"
    )


class LimitSettings(_Part):
    """What one client may cost."""

    upload_bytes: int = Field(default=2 * 1024**3, gt=0, description="largest recording that may be uploaded")
    streams: int = Field(default=64, gt=0, description="most event streams that are open at a time")
    body_window_s: float = Field(
        default=20.0, gt=0.0, description="a request's body brings at least 1 kB/s on average over so long, s"
    )
    head_s: float = Field(
        default=10.0, gt=0.0, description="a connection sends the whole head of a request in so long, s"
    )
    head_bytes: int = Field(
        default=64 * 1024, ge=4096, description="largest head of a request, address and headers together, bytes"
    )
    heads: int = Field(default=256, gt=0, description="most connections without a whole head; the oldest one goes")
    gap_s: float = Field(default=1800.0, gt=0.0, description="longest time that a gap diagnosis may take, s")
    file_memory_bytes: int = Field(
        default=2 * 1024**3, ge=2**28, description="most memory that reading, fitting or diagnosing a file may take"
    )
    file_cpu_s: float = Field(
        default=300.0, ge=1.0, description="most processor time that reading or fitting a file may take, s"
    )
    file_wall_s: float = Field(
        default=600.0, gt=0.0, description="longest time that reading or fitting a file may take, s"
    )
    file_processes: int = Field(default=2, ge=1, le=64, description="files that are processed at a time")


class RetentionSettings(_Part):
    """What is forgotten in time; never the evidence of a job."""

    recordings_days: float | None = Field(
        default=None,
        gt=0.0,
        description="oldest recording on which no job or diagnosis rests, days; none: kept",
    )
    recordings_bytes: int | None = Field(
        default=None, ge=0, description="such recordings together, bytes; the oldest go first; none: no limit"
    )
    tlogs_days: float | None = Field(
        default=None, gt=0.0, description="oldest telemetry log on which no job rests, days; none: kept"
    )
    tlogs_bytes: int | None = Field(
        default=None, ge=0, description="such telemetry logs together, bytes; the oldest go first; none: no limit"
    )
    tlog_bytes: int = Field(
        default=64 * 2**20,
        ge=2**12,
        description="size from which a link goes on in another telemetry log, bytes; never during a capture",
    )
    tlog_hours: float = Field(
        default=24.0, gt=0.0, description="age from which a link goes on in another telemetry log, hours"
    )
    events_days: float = Field(default=90.0, gt=0.0, description="oldest events of jobs that have ended, days")
    events: int = Field(default=200_000, gt=0, description="most events of jobs that have ended")
    keys_days: float = Field(default=30.0, gt=0.0, description="oldest Idempotency-Key, days")
    keys: int = Field(default=100_000, gt=0, description="most Idempotency-Keys")


class FleetSettings(_Part):
    """What several instances and workers on one PostgreSQL database agree on."""

    name: str = Field(default="", description="how this instance is named in the fleet; none: its host and port")
    url: str | None = Field(
        default=None,
        pattern=r"^https?://[^/\s]+.*$",
        description="address under which clients reach this instance, as `http://a:8765/`; told to who asks another",
    )
    lease_s: float = Field(
        default=15.0, ge=2.0, le=300.0, description="silence of an instance after which others take its links over, s"
    )


class Settings(BaseSettings):
    """Everything that can be set."""

    model_config = SettingsConfigDict(
        env_prefix="MAVCAL_", env_nested_delimiter="__", extra="forbid", frozen=True, toml_file="mavcal.toml"
    )

    host: str = Field(default="127.0.0.1", description="address to listen on; beyond loopback API keys are required")
    port: int = Field(default=8765, ge=0, le=65535, description="port to listen on; 0 takes a free one")
    data_dir: Annotated[Path, AfterValidator(_absolute)] = Field(
        default_factory=default_data_dir, description="where everything is kept; one process owns it"
    )
    database_url: SecretStr | None = Field(
        default=None,
        description="PostgreSQL database of a fleet, as `postgresql://user:key@host/name`; none: SQLite in `data_dir`",
    )
    uploads_dir: Annotated[Path, AfterValidator(_absolute)] | None = Field(
        default=None,
        description="folder of uploaded recordings, shared by all instances and workers; none: in `data_dir`",
    )
    connect: tuple[str, ...] = Field(default=(), description="endpoints opened at the start, as `udpin:0.0.0.0:14550`")
    read_only: bool = Field(default=False, description="never write to a vehicle, whatever is asked")
    log_json: bool = Field(default=False, description="log as JSON lines instead of text")
    api_keys: tuple[ApiKey, ...] = Field(default=(), description="who may use the service")
    frame_ancestors: tuple[Annotated[str, Field(pattern=r"^[^\s;,]+$")], ...] = Field(
        default=("'self'",),
        description="origins that may show the panel in a frame (Content-Security-Policy); none: nobody may",
    )
    allowed_hosts: tuple[str, ...] = Field(
        default=(), description="further host names under which the service may be addressed"
    )
    blueos: bool = Field(
        default=False,
        description="inside BlueOS: answer as `blueos.local` too, and let its pages show the panel in a frame",
    )
    allowed_origins: tuple[Annotated[str, Field(pattern=r"^https?://[^/\s]+$")], ...] = Field(
        default=(),
        description="further origins, as `https://boat.local`, whose pages may change something: of a proxy in front",
    )
    cors_origins: tuple[Annotated[str, Field(pattern=ORIGIN)], ...] = Field(
        default=(),
        description="origins, as `https://gcs.example`, whose pages may use this service from their own site",
    )
    mavlink: MavlinkSettings = Field(default_factory=MavlinkSettings, description="who we are on the wire")
    links: LinkSettings = Field(default_factory=LinkSettings, description="which endpoints may be opened over HTTP")
    limits: LimitSettings = Field(default_factory=LimitSettings, description="what one client may cost")
    fleet: FleetSettings = Field(default_factory=FleetSettings, description="several instances on one database")
    retention: RetentionSettings = Field(
        default_factory=RetentionSettings, description="what is forgotten in time; never the evidence of a job"
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Keyword before environment before file."""
        return init_settings, env_settings, TomlConfigSettingsSource(settings_cls)

    @property
    def uploads(self) -> Path:
        """Folder of uploaded recordings."""
        return self.uploads_dir or self.data_dir / "recordings"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Host names under which the service may be addressed, besides loopback."""
        return (*self.allowed_hosts, *(BLUEOS_HOSTS if self.blueos else ()))

    @property
    def blueos_origins(self) -> tuple[str, ...]:
        """Origins of the pages of BlueOS."""
        return tuple(f"http://{host}" for host in BLUEOS_HOSTS) if self.blueos else ()

    @property
    def ancestors(self) -> tuple[str, ...]:
        """Origins that may show the panel in a frame."""
        return (*self.frame_ancestors, *self.blueos_origins)

    @property
    def beyond_loopback(self) -> bool:
        """Whether the service can be reached from other machines."""
        return not is_loopback(self.host)


def check_exposure(settings: Settings) -> None:
    """Refuse to listen beyond loopback without keys.

    Raises
    ------
    AuthError
        If the service could be reached from other machines by anybody.
    """
    if settings.beyond_loopback and not settings.api_keys:
        raise AuthError(
            f"listening on {settings.host} would let anybody on the network write to vehicles: set api_keys "
            "(`mavcal config key` makes one), or listen on 127.0.0.1"
        )
