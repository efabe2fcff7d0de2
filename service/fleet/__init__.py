"""The fleet: records of every unit, and their listing.

:mod:`~service.fleet.records` makes records of jobs and preflights, :class:`~service.fleet.book.FleetBook` keeps them,
:mod:`~service.fleet.view` lists them as rows. What they mean is decided in :mod:`calib.fleet`.
"""
