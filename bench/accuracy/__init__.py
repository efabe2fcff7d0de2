"""How good the estimators of :mod:`calib` are: against the Cramer-Rao bound, and beside their peers on the same data.

``scripts/accuracy`` installs the peers and runs it all; ``python -m bench.accuracy mag --quick`` runs a slice.
"""
