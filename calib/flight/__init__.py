"""What an ordinary flight log says about the inertial sensors: rest periods, drift with temperature, sanity.

Nothing here asks an operator to do something; the tasks of :mod:`calib.procedures` do.
"""
