"""The sim-to-real gap: where a real sensor differs from the simulated one, why, and how far an effect closes it.

The way through: recordings -> :mod:`calib.gap.reference` -> :class:`calib.gap.problem.Problem` (every sensor beside
what an ideal one would have read) -> :mod:`calib.gap.diagnose` (the effects of :mod:`calib.gap.effects` in one contest)
-> :class:`calib.gap.schema.GapReport`.
"""
