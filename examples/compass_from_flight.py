"""A compass from an ordinary flight: nobody turns the vehicle by hand, and the result is a parameter file."""

# %% Load. With a log of your own: `log = read("flight.bin")`.
from examples.made import OFFSET, flown
from mavcal.calib import Sensor, bare, fit_recording, save_fits

log = flown(seed=5)
print(log)

# %% Fit. The field comes from the place and the date of the log; the heading comes from the gyroscope.
(compass,) = fit_recording(log, "mag-flight")
print(compass)
print(f"true offset {OFFSET}, heading uncertain by {compass.quality['heading_sd_deg']:.2f} deg")

# %% See it. `bare` undoes the calibration in force: the fit is of the bare sensor.
bare(log).plot(Sensor.MAG, Sensor.GYRO).save("flight.svg")
compass.plot(bare(log)).save("flight-fit.svg")

# %% Keep it: a parameter file for a ground station, which starts from the parameters of the log.
print(save_fits([compass], "compass.param", log), "parameters")
