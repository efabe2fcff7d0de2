"""``mavcal demo``: the main job end to end against a simulated vehicle, through the REST API alone."""
