"""A first look at a log, and a first fit: what was recorded, what the compass measures, how good it can be."""

# %% Load. With a log of your own: `log = read("flight.bin")`, a .tlog, an ULog or a table.
from pathlib import Path

from examples.made import turned_by_hand
from mavcal.calib import fit_recording, read, save_fits

log = read(turned_by_hand(Path("turned.csv"), seed=3))

# %% Look: channels, rates and units; then every sensor over time and as a spectrum.
print(log)
log.plot().save("first-look.svg")

# %% Fit: one result for each compass, with its uncertainty and with what the data do not say.
(compass,) = fit_recording(log, "mag-ellipsoid")
print(compass)

# %% See it: field strength before and after, ellipsoid and sphere, the directions that were measured.
compass.plot(log).save("first-fit.svg")

# %% Keep it: everything as JSON, or a C array for a firmware of your own.
save_fits([compass], "compass.json")
save_fits([compass], "compass.h")
