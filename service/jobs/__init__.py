"""Jobs: a calibration of a vehicle from its first sample to the proof of its write, or a computation on uploads.

Rooms, lowest first: `core` has the job, its journal, its store and its task; `rates` requests and returns its rates.
`uploads` computes fits and gaps. `calibrate` captures, fits and plans; `write` writes a plan. `engine` puts them
together. One word stands for one thing:

.. code-block:: text

    write      everything from the accept of a plan to its end: one `Transaction`, a `WriteContext` for each attempt
    check      compares the stream before and after a write; its answer is a `Verification`
    proof      how much of a write the check has shown; a calibration whose write succeeded is called verified
    recovery   finishes or rolls back an interrupted write, as its journal decides
    rollback   puts the old values back, because a write failed or the operator reverts it
    restore    a job that plans to write the last verified calibration again
    resume     goes on with a job that an earlier run of the service left
    restart    is always of the vehicle; the service starts and stops
    damaged    a row that cannot be read; the journal says what is known of its job
    return     puts message rates back as they were before a job, a preflight or a watch
"""
