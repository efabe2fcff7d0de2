"""Real jobs on simulated vehicles, spoilt or killed in the middle, judged by the simulator's own truth.

Every run ends ``verified``, ``as before``, or ``in doubt`` with a list that is true; anything else is a failure.
"""
