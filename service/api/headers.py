"""Headers of every answer: what a browser may do with it."""

from __future__ import annotations

from collections.abc import Mapping

from mavcal.service.settings import Settings

CONSTANT: Mapping[str, str] = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def _ancestors(settings: Settings) -> str:
    shown_by = " ".join(settings.ancestors) or "'none'"
    return f"frame-ancestors {shown_by}"


def page_policy(settings: Settings) -> str:
    """Content-Security-Policy of everything but reports."""
    return (
        "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
        f"{_ancestors(settings)}"
    )


def report_policy(settings: Settings) -> str:
    """That of reports, which carry their styles with them and run nothing, whatever a recording has put into them."""
    return f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox; {_ancestors(settings)}"
