"""Calibrates the sensors of MAVLink vehicles from the ground.

``mavcal.calib`` is pure: recordings, models, fits, knowledge of the firmwares. ``mavcal.service`` is everything that
needs a clock or a socket. ``mavcal.client`` asks a service over HTTP and imports neither. In a checkout the three are
links to the folders of that name beside this one.
"""
