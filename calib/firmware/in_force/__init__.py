"""The calibration in force on a vehicle: its parameters, its fingerprint, and how to undo it."""
