"""The part of mavcal that needs a clock or sockets."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""Limits numpy to one thread, before it is loaded and for child processes. Its matrices are small here, and threads
that wait for each other took five times the processor time."""
