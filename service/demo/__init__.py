"""``mavcal demo``: a calibration end to end on a simulated vehicle, through the REST API alone."""
