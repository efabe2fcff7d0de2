"""Facts of ArduPilot: parameters, rotations and log fields."""
