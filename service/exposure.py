"""What may be reached from elsewhere is decided before anything listens."""

from __future__ import annotations

from mavcal.service.errors import AuthError
from mavcal.service.settings import Settings


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
