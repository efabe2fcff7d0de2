"""The fleet: what is kept of every unit, and how it is told.

:mod:`~service.fleet.records` makes records of jobs and preflights, :class:`~service.fleet.book.FleetBook` keeps them,
:mod:`~service.fleet.view` tells them as rows. What they mean is known in :mod:`calib.fleet`.
"""
