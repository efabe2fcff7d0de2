"""What can go wrong in a simulated vehicle, as one tree of exceptions."""


class SimulatedVehicleError(Exception):
    """Root of every error raised by the simulated vehicle."""


class ConfigurationError(SimulatedVehicleError):
    """The configuration, truth or parameter table cannot be used: the message names the entry and what it must be."""


class ControlError(SimulatedVehicleError):
    """A request on the control channel is unknown or incomplete: the message lists what is accepted."""


class StartError(SimulatedVehicleError):
    """The simulated vehicle's process did not come up: the message carries what it said on its way down."""
