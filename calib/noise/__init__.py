"""Noise of a sensor at rest: the Allan variance and what coarse bins hide."""
