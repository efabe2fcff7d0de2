"""Calibration procedures: they take raw samples and say what to do, how far it is, and what came out.

:mod:`~calib.procedures.registry` lists them and makes one, :mod:`~calib.procedures.registry` runs one over a recording.
"""
