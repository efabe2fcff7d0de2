"""Accelerometer and gyroscope together, from poses held still and the movements between them.

``poses`` finds where the unit is still, and what it reads there. ``integrate`` carries the direction of gravity through
the movements. ``problem`` joins both into one likelihood. ``weigh`` gives every part the weight that its residuals
deserve, and ``result`` says what is known of either sensor. :func:`calib.imu.fit.fit_imu` runs it all.
"""

from mavcal.calib.imu.fit import fit_imu

__all__ = ["fit_imu"]
