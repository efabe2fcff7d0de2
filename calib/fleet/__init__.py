"""Fleet statistics of calibrations: drift, outliers, and units to calibrate again.

Pure: what was measured of each sensor and when goes in; trends with their uncertainty, comparisons with a stated rate
of false alarms, and reasons in words come out.
"""
