"""Jobs: a calibration of a vehicle from its first sample to the proof of its write, or a computation on uploads.

Rooms, lowest first: `core` has the job, its journal, its store and its task. `uploads` computes fits and gaps.
`calibrate` captures, fits and plans; `write` writes a plan. `engine` puts them together. One word stands for one thing:

.. code-block:: text

    write         everything from the accept of a plan to its end; a `Transaction` runs it, in one or more `Attempt`s
    check         compares the stream before and after a write; its answer is a `Verification`
    proof         how much of a write the check has shown
    verified      said of a calibration whose write succeeded: preflights compare with it, a restore writes it again
    recovery      finishes or rolls back a write that was interrupted, as its journal decides
    rollback      puts old values back, because a write failed or the operator reverts it
    restore       plans to write the last verified calibration again; session settings are restored after a write
    resume        goes on with a job that an earlier run of the service left
    restart       always of the vehicle; the service starts and stops
    damaged       said of a row that cannot be read; the journal says what is left of its job
    return        of message rates: they are put back as they were before a job, a preflight or a watch
"""
