"""Whole jobs against real firmwares that somebody has built: errors, intervals, sentences and times."""
