"""The table of prices: priors, penalties and thresholds of the search, with meaning, unit and source.

A deviance is twice a log-likelihood. Modules use a price as ``prices.NAME``, so a benchmark can change it in one place.
Constants that guard rounding or bound an iteration are beside their code.
"""

from __future__ import annotations

import math

import numpy as np

# Priors of amplitudes

PRIOR_VARIANCES = np.geomspace(1.0, 1e8, 33)
"""Prior variances of amplitudes that are tried.

Unit: variance of the error of the best-seen direction. Source: empirical Bayes (Clyde & George 2000); range and
steps chosen in development, seeds not recorded.
"""
SECOND_PRIOR_PRICE = 2.0 * math.log(2.0)
"""Price of a prior that is not the first one.

Unit: deviance. Source: choice of one in two; decision 10.
"""
# Prices of searches

FIXED_SHAPE_SIDES = 2
"""Grid size of an effect whose shape alone is estimated.

Unit: values. Source: an effect that vanishes at zero is searched to either side.
"""
# Prices of kinds of effects

DRIFT_PRICE = 16.0
"""Price of drift noise: it fits any slow change, so a named cause that fits nearly as well is preferred.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
SHAPE_PRICES = {
    "simplest": 4.0,
    "driven": 8.0,
    "own": 12.0,
    "linear": 14.0,
    "approach": 16.0,
    "product": 16.0,
    "line": 16.0,
    "periodic": 20.0,
    "time": 32.0,
}
"""Price of a shape by its family: less for shapes with fewer possible causes. A periodic shape also pays for its
frequency.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
SHAPE_PART_PRICE = 3.5
"""Added price of a part of a shape, which is the best of many.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
THERMAL_PRICE = 3.0
"""Price of a thermal effect: an effect at every recorded temperature, or one that began at some time, is simpler.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
REPEATED_JUMP_PRICE = 10.0
"""Price of one more jump on a sensor that jumps already.

Unit: deviance a jump. Source: decision 11 (T6, development seeds 90600-90639).
"""
REFERENCE_PRICE = 8.0
"""Price of an error of the reference instead of a sensor.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
EFFECT_COUNT_PRICE = 6.0
"""Price of each effect between models with different numbers of effects: four are less likely than one.

Unit: deviance an effect. Source: decision 11; value chosen in development, seeds not recorded.
"""
# Thresholds of the selection

SECOND_ORDER_SHARE = 0.005
"""Share below which an effect counts as a second-order term of the large ones.

Unit: share of the largest gain. Source: GAP, pitfalls.
"""
FLIGHT_SECOND_ORDER_SHARE = 0.01
"""The same where the noise was learned from flights, which always contain small true structure.

Unit: share of the largest gain. Source: chosen in development, seeds not recorded.
"""
ENTRY_SHARE = 0.3
"""Share below which an effect does not enter the model.

Unit: share of that least gain. Source: chosen in development, seeds not recorded.
"""
OTHER_SENSOR_SHARE = 3e-5
"""Share below which an effect on another sensor counts as an error of the reference.

Unit: share of the largest gain of all. Source: chosen in development, seeds not recorded.
"""
HIDING_GAIN = 0.1
"""Gain above which previously fitted noise hides the differences between effects.

Unit: deviance a number. Source: chosen in development, seeds not recorded.
"""
SLOW_POWER_RATIO = 4.0
"""Power of the lowest bin over the highest, above which noise may have absorbed a slow effect.

Unit: ratio of powers. Source: chosen in development, seeds not recorded.
"""
RIVAL_SHARE = 0.5
"""Share above which another candidate is fitted in place of the best one.

Unit: share of the best one's worth. Source: chosen in development, seeds not recorded.
"""
RIVALS_TRIED = 6
"""Most candidates that are fitted in place of the best one.

Unit: candidates. Source: chosen in development, seeds not recorded.
"""
CANDIDATES_FITTED = 3
"""Candidates, the best on their grids, that are fitted at their best shapes before one of them enters.

Unit: candidates. Source: chosen in development, seeds not recorded.
"""
MOST_IN_A_ROW = 8
"""Most consecutive effects that enter, not counting events.

Unit: effects. Source: chosen in development, seeds not recorded.
"""
MOST_EVENTS = 3
"""Most events that may enter after them.

Unit: events. Source: chosen in development, seeds not recorded.
"""
FLIGHT_DIFFERENCE = 0.03
"""Evidence by which any two flights differ: a re-estimated reference is not more certain than that.

Unit: deviance a number. Source: chosen in development, seeds not recorded.
"""
# Thresholds of the contest

REFINEMENT_GAIN = 8.0
"""Gain of the best value on the grid above which the shape is refined between its neighbours.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
EXACT_FIT_GAIN = 300.0
"""Gain above which an effect that is nonlinear in its amplitudes is fitted without linearisation.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
ENVELOPE_GAIN = 6.0
"""Gain on an axis above which the noise is tested against its envelope.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
INDEPENDENT_ENERGY = 1e-6
"""Least energy of a column orthogonal to the model's other columns; with less it is ignored.

Unit: share of a column's energy. Source: chosen in development, seeds not recorded.
"""
# Thresholds of noise and lines

FLIGHT_NOISE_RATIO = 1.0
"""Least ratio of added noise to learned noise, at the frequency where it is largest.

Unit: ratio of powers. Source: chosen in development, seeds not recorded.
"""
LINE_UNSTEADINESS = 0.05
"""Share below which noise and other lines near a line count as its own unsteadiness.

Unit: share of a line's power. Source: chosen in development, seeds not recorded.
"""
LINE_REACH_HZ = 2.0
"""Distance from a line's frequency within which its power is measured.

Unit: Hz. Source: chosen in development, seeds not recorded.
"""
INSTANCE_SHARE = 0.2
"""Least excess of another instance for it to be part of the effect.

Unit: share of the largest excess. Source: chosen in development, seeds not recorded.
"""
FILTER_BAND_SHARE = 0.25
"""Frequency below which a residual may be movement.

Unit: share of the Nyquist frequency. Source: chosen in development, seeds not recorded.
"""
SAMPLE_DIFFERENCE = 0.25
"""Difference up to which the samples of two recordings of one sensor are equal.

Unit: relative difference. Source: chosen in development, seeds not recorded.
"""
NOMINAL_TONE_SHARE = 0.3
"""Share above which a nominal recording has the tone as well.

Unit: share of a tone's amplitude. Source: chosen in development, seeds not recorded.
"""
LINE_TO_NEIGHBOURS = 12.0
"""Least energy of a line over that of its neighbours.

Unit: ratio of energies. Source: chosen in development, seeds not recorded.
"""
LINE_NEIGHBOURS = 40
"""Frequencies on either side, the nearest two apart, that a line is compared with.

Unit: frequencies. Source: chosen in development, seeds not recorded.
"""
# Exchanges of effects

RIVAL_REACH = 40.0
"""Deficit in penalised evidence beyond which a rival is neither refined nor listed; wandering noise adds its own price.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
MOST_EXCHANGES = 3
"""Most exchanges.

Unit: exchanges. Source: chosen in development, seeds not recorded.
"""
WORTH_A_FIT = 0.05
"""Gain above which the noise is fitted again when an effect on the mean replaces added noise.

Unit: share of the gain of the added noise. Source: chosen, not measured: an effect of a fifth of the noise's amplitude.
"""
EXCHANGES_TRIED = 2
"""Number of best exchanges tried before giving up.

Unit: exchanges. Source: chosen in development, seeds not recorded.
"""
SECOND_ORDER_LOSS = 0.1
"""Second-order loss that is accepted for an effect with fewer parameters: a model is never exact.

Unit: share of the second order. Source: chosen in development, seeds not recorded.
"""
EVENT_GAIN_SHARE = 0.1
"""Improvement required of a model with events first: a jump at an end is an offset.

Unit: share of the largest gain. Source: chosen in development, seeds not recorded.
"""
# The wandering attitude of the reference

WANDER_SIZES_DEG = np.geomspace(0.0025, 3.0, 11)
"""Root mean squares of the attitude error that are tried.

Unit: deg. Source: chosen in development, seeds not recorded.
"""
WANDER_TIMES_S = (2.0, 6.0, 20.0, 60.0)
"""Correlation times of the attitude error that are tried.

Unit: s. Source: chosen in development, seeds not recorded.
"""
WANDER_SLACK = 10.0
"""Allowance for the evidence that other effects may add once chosen beside a wandering attitude.

Unit: deviance. Source: chosen in development, seeds not recorded.
"""
