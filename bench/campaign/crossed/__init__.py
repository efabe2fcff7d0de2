"""Network faults crossed with process faults crossed with vehicle faults, over whole jobs, thousands of times.

A run is one job on one simulated vehicle. A forked child carries the first life of the service where that life ends by
SIGKILL or by a loss of power; the life after it, or the only one, runs in the worker itself.
"""
