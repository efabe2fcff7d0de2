"""How good the estimators of :mod:`calib` are: against the Cramer-Rao bound, and beside their peers on the same data.

.. code-block:: text

    bounds      Fisher information, written from the models alone: shares no code with any estimator
    scenes      truths, movements, noise, what a MAVLink stream does to the numbers
    campaign    draws, contenders, tallies: error over bound with its own standard error, intervals, time, memory
    peers       installable programs and plain scipy forms behind one signature; what is not installed says so
    rows_*      one module a row of the table: mag (full, tilted, outliers), six_face, thermal, align, imu, allan
    page        docs/accuracy.md

``scripts/accuracy`` installs the peers and runs it all; ``python -m bench.accuracy mag --quick`` runs a slice.
"""
