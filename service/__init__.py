"""The part of mavcal that needs a clock or sockets."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""Before numpy is loaded, and for child processes: its matrices are small here, and threads that wait for each other
took five times the processor time."""
