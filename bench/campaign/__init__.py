"""The fault campaign: real jobs on simulated vehicles, spoilt in the middle, judged by the simulator's own truth.

``python -m bench.campaign`` runs all of it; ``scripts/campaign`` is the same by one command. Two parts:

* **fault runs** (:mod:`.fault_run`): the service's engine in this process, a vehicle in its own, job, plan, apply, and
  faults that strike after the first PARAM_SET;
* **kill runs** (:mod:`.kill_run`): ``mavcal serve`` as a process that is killed by SIGKILL when its journal reaches a
  chosen step, and started again.

Every run ends ``verified``, ``as before``, or ``in doubt`` with a list that is true; anything else is a failure.
"""
