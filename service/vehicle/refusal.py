"""The error of a write that may not be made now."""

from __future__ import annotations

from typing import NoReturn

from mavcal.service.errors import VehicleArmed, VehicleBusy, VehicleConflict, VehicleError, VehicleSilent
from mavcal.service.vehicle.state import Refusal, Writable


def refuse(found: Writable, name: str, sent: int) -> NoReturn:
    """Raise the error of the first of its reasons: `name` was sent so often, or "" for a write at all."""
    doing = f"{name} was not written" if name else "Nothing is written"
    if sent:
        doing = f"{name} was sent {sent} times and not confirmed; it is not sent again"
    text = f"{doing}: {'; '.join(found.reasons)}."
    errors: dict[Refusal, type[VehicleError]] = {
        Refusal.SILENT: VehicleSilent,
        Refusal.ARMED: VehicleArmed,
        Refusal.CONFLICT: VehicleConflict,
        Refusal.NOT_LANDED: VehicleBusy,
        Refusal.CALIBRATING: VehicleBusy,
    }
    error = next(errors[refusal] for refusal in errors if refusal in found.refusals)(text)
    error.sent = sent
    raise error
