"""What the calibrations of many vehicles say together: drift, odd ones out, and who should be calibrated again.

Pure: what was measured of each sensor and when goes in; trends with their uncertainty, comparisons with a stated rate
of false alarms, and reasons in words come out.
"""
