"""Calibration procedures: raw samples in; prompts, progress and fits out.

:mod:`~calib.procedures.registry` lists them and makes one, :mod:`~calib.procedures.registry` runs one over a recording.
"""
