"""Jobs: one calibration of one vehicle, from its first sample to the proof that what was written took effect.

.. code-block:: text

    engine ── admission     who may begin what
      │ └──── feed, handle  events, the durable value of a job
      ├ adoption            a plan of fits, and a job of an uploaded recording
      ├ runner: capture (watch, digest, spans, streams) ─> fit of the closed segments ─> planning
      └ transaction: write, verify, restart, finish ─ rollback;  journal decides after any interruption
    port: what is needed of a vehicle;  vehicle_adapter: the real ones
"""
