"""Inertial sensors in an ordinary flight log: rest periods, drift with temperature, sanity checks.

Nothing here asks an operator to do something; the tasks of :mod:`calib.procedures` do.
"""
