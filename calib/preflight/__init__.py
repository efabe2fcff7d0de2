"""Checks whether the sensors and their calibration allow a flight.

Pure: a few seconds of streams at rest, the parameters, and what earlier verified calibrations left go in; a report of
checks comes out. Every check carries its value with its uncertainty, its limit with the limit's source, and a remedy.
"""
