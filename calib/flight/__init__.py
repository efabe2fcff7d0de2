"""What an ordinary flight log says of the inertial sensors: its rest periods, their drift with temperature, its sanity.

Below the tasks of :mod:`calib.procedures`, which ask an operator to do something: here nobody does.
"""
