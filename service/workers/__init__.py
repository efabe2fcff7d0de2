"""Processor work of a fleet: computations that instances ask for in the database, and workers that do them.

What runs is what a single machine runs in its child processes, within the same limits. A computation is a row with its
order and, in the end, its result. ``procrastinate`` hands it to a worker, one a vehicle at a time, and to another one
if that worker dies. Recordings are read from a folder that all share; none of their bytes is in the database.
"""
