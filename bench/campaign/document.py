"""``docs/fault-campaign.md``: what the campaign is, and what it measured last."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.campaign.criteria import Criterion
from bench.campaign.crossed.report import CrossReport
from bench.campaign.crossed.tables import cross_tables
from bench.campaign.report import FaultReport, KillReport
from bench.campaign.starved import StarvedReport, starved_table
from bench.campaign.tables import cli_table, criteria_table, fault_tables, kill_table

CROSSED_METHOD = """\
`scripts/campaign crossed` draws one fault of the network, one of the service and its machine, and one of the vehicle.
Each is let loose while the job captures, writes or checks. All 512 cells come once in each block of 512 runs. Jobs are
gyro, level, accel and mag; the vehicle's clock runs 20 times faster than the wall's, 10 times where frames are out of
order.

A service that dies is a forked process that gets SIGKILL at a named instant of the job engine. A loss of power leaves
what had been brought onto the disk, and of the rest a piece of random length. A full disk refuses one kind of write, a
database that is gone every write, for a while; a slow disk takes 50 ms for each forced write. The wall clock jumps by
two hours, forward and back. The next life of the service has to bring the job to its end.

`scripts/campaign crossed --postgresql --crosses N` starts a PostgreSQL on loopback, with a database for each run.

After the last life the store is opened again and compared with the vehicle and with a ledger of everything that it had
taken. Jobs, journal, plans and segments must be there, and the samples of each segment must have their digest. No
telemetry log may have lost what it held, and each parameter must hold what the journal confirms last."""

TEXT = """# Fault campaign

`scripts/campaign` lets real jobs (capture, plan, accept, write, check) run against simulated vehicles of both
autopilots and spoils them after the first PARAM_SET. It prints the tables below, writes this file and exits 1 if
anything that is to be shown is not. `scripts/campaign faults --seed S --run N` repeats a single run.

Every run is judged by the simulator alone, never by the service's word:

* **verified**: the job succeeded, every parameter of the plan is stored with its new value, and nothing else changed.
  Under the values in force, the true residual error of every calibrated sensor is within 4.5 times the standard
  deviation that was asked for.
* **as before**: every parameter is stored as it was before the accept. What a third party wrote stays, and is named by
  the job where it lies on a parameter of the plan.
* **in doubt, list true**: every value that the job calls certain is stored. Every other one is the old, the new or the
  one heard. Nothing outside the list changed, and the vehicle takes no new job. Where an operator then disarms the
  vehicle or mends the link, the job has to come out of its doubt by itself.
* **FAILURE**: anything else, jobs that never end and PARAM_SETs to an armed vehicle among them.

Gyro offsets that the vehicle rewrites by itself (`INS_GYR_CAL`, `IMU_GYRO_CAL_EN`) count as nobody's change where the
job has not written them. Where PX4 rewrites them in mid-write and the job then takes its own values back, PX4's stay.
The job has to name them.

A fault on the wire counts as a strike if it was switched on with a PARAM_SET, or later, and hit at least one frame. The
vehicle's clock runs 20 times faster than the wall's, but 5 times faster where a bad wire costs wall time. At 20 times,
a frame that is held back looks like a restarted clock, and a gyro may drift between the two windows of a check.
"Accepted but not applied" is measured against the standard deviation of the stream check.

In the SIGKILL runs the service is `mavcal serve` in a process of its own. It gets SIGKILL from outside when its
journal reaches a chosen step, and is started again on the same data directory. The journal is read through a connection
that cannot write; the step that counts is the last one that lay in the journal when the process was dead.

## What was measured (seed {seed})

{criteria}

## Faults

{faults}

## SIGKILL

{kills}

## SIGKILL of the command line

`mavcal calibrate gyro --apply --reboot` kills itself at a named instant of the job engine; `mavcal recover`, or the
same command again, has to put the vehicle right and to end with exit code 0.

{commands}

## Network × process × vehicle

{method}

{crossed}

## A starved machine

`scripts/campaign starved` lets a service run gyro jobs on one processor beside 12 processes that never rest, as on a
machine with a load of 25 on two cores. The simulated vehicle has the other processor.

{starved}
"""


def write_document(
    path: Path,
    seed: int,
    faults: Sequence[FaultReport],
    killed: Sequence[KillReport],
    commands: Sequence[KillReport],
    crossed: Sequence[CrossReport],
    starved: Sequence[StarvedReport],
    criteria: Sequence[Criterion],
) -> None:
    """Write the document of a whole campaign."""
    text = TEXT.format(
        seed=seed,
        criteria=criteria_table(criteria),
        faults=fault_tables(faults),
        kills=kill_table(killed),
        commands=cli_table(commands),
        method=CROSSED_METHOD,
        crossed=cross_tables(crossed),
        starved=starved_table(starved),
    )
    path.write_text(text, encoding="utf-8")


CROSSED = """# Crossed faults

{method}

## What was measured (seed {seed}, store {store})

{criteria}

{crossed}
"""


def write_crossed(
    path: Path, seed: int, store: str, crossed: Sequence[CrossReport], criteria: Sequence[Criterion]
) -> None:
    """Write the page of a crossed campaign alone."""
    text = CROSSED.format(
        seed=seed,
        store=store,
        criteria=criteria_table(criteria),
        method=CROSSED_METHOD,
        crossed=cross_tables(crossed),
    )
    path.write_text(text, encoding="utf-8")
