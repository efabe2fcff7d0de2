"""Offset and soft iron of a magnetometer that is turned in the Earth's field, with their uncertainty.

.. code-block:: text

    simple_fits                       extremes, sphere, ellipsoid along the axes: specified methods, starting values
    ellipsoid                         the full fit: moments (one pass) -> distance (orthogonal) -> robust (outliers)
    shape_fit                         its least squares, or averaged over how much soft iron the samples show
    running                           one pass with its covariance: recursive, mergeable, with forgetting
    accumulator  coverage             for a live procedure: the samples so far, what they are worth, where to turn next
    blur  blur_fit                    a compass that averages while it turns
    rings  align  gyro_aided          the mounting as well: turns about the vertical, accelerometer, gyroscope
    flight  motor  fixed_yaw          in flight, against the motors' currents, at one known heading
    ellipsoid_result                  the verdict on an ellipsoid
    result                            the one maker of results, for all of them
    samples  shape  serial  heading   what these share

Every fit takes samples (N, 3) in order of time and the keywords of :class:`calib.mag.result.MagContext`. It returns a
:class:`calib.fit.FitResult` over offset and matrix, whose ``quality`` holds

==========================  =====================================================================================
``heading_sd_deg``          heading error at the worst heading, level and up to 30 deg of tilt, at ``heading_dip_deg``
``offset_sd_ut``            offset error along the worst axis, uT; None where samples are counts and no field is known
``coverage_mask``           ten bytes, the 80 sections of the sphere that the field was seen in; ``coverage`` 0..1
``residual_rms``            distance from the ellipsoid, in the unit of the samples
``chi2``, ``dof``           against ``noise_sd``, which is given or comes from successive residuals (``noise_from``)
``p_value``, ``white``      chance of so large a ``chi2``, None unless the noise is given; whether residuals are white
``variance_inflation``      largest factor by which residuals that are correlated in time widened the covariance
``field_ratio``             measured over modelled field strength; None where one of them is not known
``n_outliers``              samples that were left out
``radius``, ``axis_ratio``  of the ellipsoid
==========================  =====================================================================================
"""

from mavcal.calib.mag.accumulator import EllipsoidAccumulator
from mavcal.calib.mag.blur import deblurred, rates_during
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.coverage import Advice, Coverage
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.moments import adjusted_least_squares
from mavcal.calib.mag.orientation import MountingVerdict, OrientationResult, find_orientation
from mavcal.calib.mag.result import MagContext
from mavcal.calib.mag.running import RunningEllipsoid
from mavcal.calib.mag.shape import MagModel
from mavcal.calib.mag.simple_fits import fit_ellipsoid_axis, fit_minmax, fit_sphere

__all__ = [
    "Advice",
    "Coverage",
    "EllipsoidAccumulator",
    "MagContext",
    "MagModel",
    "MountingVerdict",
    "OrientationResult",
    "RunningEllipsoid",
    "adjusted_least_squares",
    "deblurred",
    "find_orientation",
    "fit_ellipsoid",
    "fit_ellipsoid_axis",
    "fit_ellipsoid_deblurred",
    "fit_minmax",
    "fit_sphere",
    "heading_sd_deg",
    "rates_during",
]
