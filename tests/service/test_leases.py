"""Leases: one owner at a time by the database's clock, and transactions that only the owner ends."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mavcal.service.errors import LeaseLost
from mavcal.service.instances import leases as leases_module
from mavcal.service.instances.leases import Leases, Owner
from mavcal.service.store.postgres import PostgresStore
from mavcal.service.store.rows import JobRow

ROOT = Path(__file__).resolve().parents[2]
LEASE_S = 60.0
ROW = JobRow("j1", "v1", "gyro", "applying", 1.0, 1.0, {})


@pytest.fixture
def a(database_url: str) -> Iterator[Leases]:
    leases = Leases(database_url, Owner("id-a", "a", None), LEASE_S)
    yield leases
    leases.close()


@pytest.fixture
def b(database_url: str) -> Iterator[Leases]:
    leases = Leases(database_url, Owner("id-b", "b", "http://b/"), LEASE_S)
    yield leases
    leases.close()


@pytest.fixture
def passes(a: Leases, monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Lets so many seconds pass for every lease, by the clock here and by that of the database.

    A lease so short that a test can wait for its end would also end wherever the machine is late.
    """
    real, ahead = leases_module.clock, 0.0
    monkeypatch.setattr(leases_module, "clock", lambda: real() + ahead)

    def pass_by(seconds: float) -> None:
        nonlocal ahead
        ahead += seconds
        a._run("UPDATE leases SET expires = expires - make_interval(secs => ?)", (seconds,))

    return pass_by


@pytest.fixture
def store(database_url: str) -> Iterator[PostgresStore]:
    store = PostgresStore(database_url, None)
    store.save_job(ROW)
    yield store
    store.close()


def test_one_owns_what_another_asks_for_and_renewal_keeps_it(
    a: Leases, b: Leases, passes: Callable[[float], None]
) -> None:
    assert a.acquire("vehicle:v1")
    for _ in range(4):
        assert not b.acquire("vehicle:v1")
        assert a.renew() == set()
        assert a.holds("vehicle:v1")
        passes(LEASE_S / 3)
    assert {subject: owner.name for subject, owner in b.owners().items()} == {"vehicle:v1": "a"}
    a.release("vehicle:v1")
    assert b.acquire("vehicle:v1")
    assert str(a.owners()["vehicle:v1"]) == "b (http://b/)"


def test_one_that_ran_out_is_had_by_another_and_the_first_owner_is_told(
    a: Leases, b: Leases, passes: Callable[[float], None]
) -> None:
    assert a.acquire("vehicle:v1")
    assert a.acquire("link:l1")
    passes(1.2 * LEASE_S)
    assert not a.holds("vehicle:v1")  # known without asking
    assert b.acquire("vehicle:v1")
    assert a.renew() == {"vehicle:v1"}
    assert a.mine("") == ("link:l1",)  # nobody took that one
    assert a.holds("link:l1")
    assert b.renew() == set()


def test_the_same_instance_takes_its_own_back_at_once_after_a_restart(database_url: str, b: Leases) -> None:
    assert b.acquire("vehicle:v1")
    again = Leases(database_url, Owner("id-b", "b", None), 60.0)
    assert again.acquire("vehicle:v1")
    assert b.renew() == {"vehicle:v1"}  # its former life is over
    again.close()


def test_who_lost_the_lease_keeps_nothing_more(
    a: Leases, b: Leases, store: PostgresStore, passes: Callable[[float], None]
) -> None:
    assert a.acquire("vehicle:v1")
    ours = store.fenced(a.fence("vehicle:v1"))
    ours.add_journal("j1", 1.0, "send", {})
    passes(1.2 * LEASE_S)
    with pytest.raises(LeaseLost):
        ours.add_journal("j1", 2.0, "echo", {})  # it ran out, although nobody has it yet
    assert a.renew() == set()
    ours.add_journal("j1", 3.0, "echo", {})
    passes(1.2 * LEASE_S)
    assert b.acquire("vehicle:v1")
    theirs = store.fenced(b.fence("vehicle:v1"))
    theirs.add_journal("j1", 4.0, "roll_back", {})
    with pytest.raises(LeaseLost):
        ours.add_journal("j1", 5.0, "send", {})
    with pytest.raises(LeaseLost):
        ours.save_job(ROW, event=("state", {}))
    assert a.renew() == {"vehicle:v1"}
    with pytest.raises(LeaseLost):
        a.fence("vehicle:v1")
    assert [step.at for step in store.journal("j1")] == [1.0, 3.0, 4.0]


def test_a_lease_cannot_be_taken_in_the_middle_of_a_transaction_of_its_owner(
    a: Leases, b: Leases, store: PostgresStore
) -> None:
    """What the new owner reads has all that the old one could still keep."""
    a.lease_s = 2.0
    assert a.acquire("vehicle:v1")
    ours = store.fenced(a.fence("vehicle:v1"))
    seen: list[int] = []

    def take() -> None:
        assert b.acquire("vehicle:v1")
        seen.append(len(store.journal("j1")))

    with ours._write() as db:
        time.sleep(1.2 * a.lease_s)  # the lease ends while its owner is inside: that row cannot be changed now
        taking = threading.Thread(target=take)
        taking.start()
        time.sleep(0.3)
        assert seen == []
        db.execute("INSERT INTO journal (job_id, at, step, data) VALUES ('j1', 1.0, 'send', '{}')")
    taking.join()
    assert seen == [1]


@pytest.mark.long
def test_one_machine_imports_nothing_of_all_this() -> None:
    code = (
        "import sys; import mavcal.service.app, mavcal.service.core, mavcal.service.commands.serve; "
        "print([name for name in sys.modules if name.partition('.')[0] in {'psycopg', 'procrastinate', 'sqlalchemy'} "
        "or name.startswith(('mavcal.service.instances', 'mavcal.service.workers', 'mavcal.service.store.postgres'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_fleet_is_asked_for_by_name_where_it_is_not_installed() -> None:
    code = (
        "import sys; sys.modules['procrastinate'] = None\n"
        "from importlib import util\nfound = util.find_spec\n"
        "from mavcal.service import storing\n"
        "storing.find_spec = lambda name: None if name == 'procrastinate' else found(name)\n"
        "from mavcal.service.settings import Settings\n"
        "storing.require_fleet(Settings(database_url='postgresql://127.0.0.1/x'))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "pip install 'mavcal[fleet]'" in done.stderr
