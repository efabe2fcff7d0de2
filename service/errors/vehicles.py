"""What goes wrong between the service and a vehicle: links, states, commands, parameters."""

# ruff: noqa: N818 - a name says what happened; "Error" behind each of them would say it again

from __future__ import annotations

from mavcal.service.errors.base import ServiceError


class LinkError(ServiceError):
    """The link does not work; see its state for the reason."""

    status_code = 503
    title = "Link error"
    code = "link-error"


class LinkDown(LinkError):
    """The link is down; it reconnects by itself once the other side is there again."""

    title = "Link down"
    code = "link-down"


class EndpointError(LinkError):
    """Not an endpoint. Give udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD or file:PATH."""

    status_code = 422
    title = "Unknown endpoint"
    code = "endpoint-unknown"


class EndpointRefused(EndpointError):
    """Not an endpoint that may be opened over the network: `links` in the settings says which may."""

    status_code = 403
    title = "Endpoint not allowed"
    code = "endpoint-refused"


class LinkUnknown(LinkError):
    """No such link. GET /api/v1/links lists them."""

    status_code = 404
    title = "Link unknown"
    code = "link-unknown"


class LinkElsewhere(LinkError):
    """Another instance of the service has this link open. Ask that one."""

    status_code = 409
    title = "Link elsewhere"
    code = "link-elsewhere"


class LinkOpen(LinkError):
    """The link is open and signed with another key. Close it first."""

    status_code = 409
    title = "Link open with another key"
    code = "link-open"


class LinkBusy(LinkError):
    """A write runs over this link, or is in doubt. Let it end, or open another link to the same vehicle first."""

    status_code = 409
    title = "A write needs this link"
    code = "link-busy"


class SigningKeyError(LinkError):
    """The signing key cannot be used like that."""

    status_code = 409
    title = "Signing key refused"
    code = "signing-key-error"


class SigningKeyUnknown(SigningKeyError):
    """No such signing key. GET /api/v1/signing-keys lists them."""

    status_code = 404
    title = "Signing key unknown"
    code = "signing-key-unknown"


class SigningNotConfirmed(SigningKeyError):
    """The vehicle did not confirm the signing key: the link stays unsigned."""

    status_code = 503
    title = "Signing not confirmed"
    code = "signing-not-confirmed"


class PortBusy(LinkError):
    """Another program uses this port. Stop it, or let it forward to another port and connect to that one."""

    status_code = 409
    title = "Port busy"
    code = "port-busy"


class VehicleError(ServiceError):
    """The vehicle did not do what was asked."""

    status_code = 503
    title = "Vehicle error"
    code = "vehicle-error"

    sent: int = 0
    """While writing a parameter: how many PARAM_SET had left. With 0 the vehicle cannot have changed by them."""


class VehicleSilent(VehicleError):
    """The vehicle is silent: no heartbeat for 3 s. Check its power and the link, then try again."""

    title = "Vehicle silent"
    code = "vehicle-silent"


class VehicleUnknown(VehicleError):
    """No such vehicle. GET /api/v1/vehicles lists those that were heard."""

    status_code = 404
    title = "Vehicle unknown"
    code = "vehicle-unknown"


class WatchUnknown(VehicleError):
    """The watch is over, or of another vehicle. POST /api/v1/vehicles/{vehicle_id}/watches begins one."""

    status_code = 404
    title = "Watch unknown"
    code = "watch-unknown"


class NotSimulated(VehicleError):
    """Only a simulated vehicle is turned from here. Turn this one with your hands."""

    status_code = 409
    title = "Not simulated"
    code = "not-simulated"


class HandBusy(VehicleError):
    """The simulated vehicle is not in your hand. Choose `mouse` as its hand first."""

    status_code = 409
    title = "Not in your hand"
    code = "hand-busy"


class UnitUnknown(VehicleError):
    """No such unit. GET /api/v1/fleet lists the known ones."""

    status_code = 404
    title = "Unit unknown"
    code = "unit-unknown"


class VehicleArmed(VehicleError):
    """The vehicle is armed, or was a moment ago. Disarm it, on the ground, and wait 2 s."""

    status_code = 409
    title = "Vehicle armed"
    code = "vehicle-armed"


class VehicleBusy(VehicleError):
    """The vehicle is not ready: it is calibrating by itself, or not known to be on the ground."""

    status_code = 409
    title = "Vehicle busy"
    code = "vehicle-busy"


class VehicleConflict(VehicleError):
    """Who is being talked to is not certain: two vehicles share a system id, or somebody else uses our ids."""

    status_code = 409
    title = "Vehicle conflict"
    code = "vehicle-conflict"


class CommandRefused(VehicleError):
    """The vehicle refused the command."""

    status_code = 409
    title = "Command refused"
    code = "command-refused"

    def __init__(self, message: str | None = None, *, command: int = 0, result: int = 0) -> None:
        super().__init__(message)
        self.command = command
        """MAV_CMD that was refused."""
        self.result = result
        """MAV_RESULT of the answer."""


class CommandTimeout(VehicleError):
    """The vehicle did not acknowledge the command; whether it was executed is not known."""

    title = "Command not acknowledged"
    code = "command-timeout"


class ForbiddenCommand(VehicleError):
    """A command that can harm the vehicle or people is never sent by this software."""

    status_code = 409
    title = "Command forbidden"
    code = "command-forbidden"


class ParameterError(VehicleError):
    """A parameter could not be read or written."""

    status_code = 409
    title = "Parameter error"
    code = "parameter-error"

    def __init__(self, message: str | None = None, *, name: str = "", sent: int = 0) -> None:
        super().__init__(message)
        self.name = name
        """The parameter."""
        self.sent = sent


class ParameterMissing(ParameterError):
    """The vehicle has no such parameter: it answers, but not to this name."""

    status_code = 404
    title = "Parameter missing"
    code = "parameter-missing"


class ParameterTimeout(ParameterError):
    """The vehicle did not answer in time; the value of the parameter is not known."""

    status_code = 503
    title = "Parameter not answered"
    code = "parameter-timeout"


class ParameterRejected(ParameterError):
    """The vehicle holds another value than the one that was written, or the value cannot be sent."""

    title = "Parameter rejected"
    code = "parameter-rejected"
