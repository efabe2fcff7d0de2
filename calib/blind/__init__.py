"""The foreign generator of the withheld-effect check.

Missions, sensors and their errors, written from physics at eight times the log rate, sealed before they are diagnosed,
and the scores of what a diagnosis answered. It shares no code with ``calib.gap`` and ``calib.simulate``: it knows the
diagnosis only by the JSON that it prints, so that the check has two authors.
"""
