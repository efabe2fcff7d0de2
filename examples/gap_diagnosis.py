"""Where a sensor differs from its simulation, which effect causes it, and the parameters that close the gap."""

# %% Load. With files of your own: `real = read("flight.csv")`, whose ref_* columns hold what an ideal sensor reads.
from examples.made import CLEAN, REAL, beside_ideal
from mavcal.calib import diagnose, save_report

real = beside_ideal(REAL, seed=10)
nominal = [beside_ideal(CLEAN, seed=seed) for seed in (11, 12)]

# %% Diagnose. Recordings without an effect teach it the noise.
report = diagnose(real, nominal=nominal, nested=False)
print(report)

# %% See it: the residual of each sensor over time, and its spectrum, before and with the effects.
report.plot().save("gap.svg")

# %% Ask it: each effect with its probability, each parameter with its 95 % interval.
for effect in report.effects:
    for parameter in effect.params:
        low, high = parameter.ci95
        print(f"{effect.id:20} {parameter.name:12} {parameter.value:8.4f} ({low:.4f} to {high:.4f}) {parameter.unit}")

# %% Keep it: a page with pictures, and sensor errors for `mavcal simulate recording --params gap.json`.
save_report(report, "gap.html")
print(save_report(report, "gap.json", real))
