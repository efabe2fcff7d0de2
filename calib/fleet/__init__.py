"""Fleet statistics of calibrations: drift, outliers, and units to calibrate again.

The functions are pure. They take the measurements of each sensor with their times. They return trends with their
uncertainty, comparisons with a stated rate of false alarms, and reasons in words.
"""
