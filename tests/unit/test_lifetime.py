"""Processes end with the one that started them, and a session finds those that do not."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from mavcal.service.lifetime import ENDS_WITH, alive, follow
from tests import processes
from tests.patience import crowding, patience, scaled

SLEEP = "import time; print('up', flush=True); time.sleep(600)"
FOLLOWING = f"from mavcal.service.lifetime import follow; follow(); {SLEEP}"
PARENT = f"""
import subprocess, sys
from mavcal.service.lifetime import ending_with_us
child = subprocess.Popen([sys.executable, "-c", {FOLLOWING!r}], env=ending_with_us(), stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
child.wait()
"""


def ends(pid):
    limit = patience(10.0)
    while alive(pid) and not limit.over:
        threading.Event().wait(0.05)
    return not alive(pid)


def test_a_child_ends_when_its_parent_is_killed():
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        assert alive(child)
        parent.kill()
    try:
        assert ends(child)
    finally:
        if alive(child):
            os.kill(child, signal.SIGKILL)


def test_nobody_is_followed_who_is_not_named():
    assert not follow({})
    assert not follow({ENDS_WITH: "nobody"})
    assert not follow({ENDS_WITH: str(os.getpid())})


def test_the_end_comes_once_the_named_process_is_gone():
    over = threading.Event()
    with subprocess.Popen([sys.executable, "-c", SLEEP], stdout=subprocess.PIPE, text=True) as other:
        other.stdout.readline()
        assert follow({ENDS_WITH: str(other.pid)}, end=over.set)
        assert not over.wait(0.3)
        other.kill()
    assert over.wait(scaled(10.0))


@pytest.mark.long
def test_the_command_line_follows(tmp_path):
    command = [sys.executable, "-m", "mavcal", "serve", "--json", "--port", "0", "--data-dir", str(tmp_path)]
    with subprocess.Popen([sys.executable, "-c", SLEEP], stdout=subprocess.PIPE, text=True) as other:
        other.stdout.readline()
        environment = {**os.environ, ENDS_WITH: str(other.pid)}
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as service:
            assert service.stdout.readline()
            other.kill()
            other.wait()
            try:
                service.wait(scaled(20.0))
            finally:
                service.kill()


def session(how):
    """A process that stands for a test session and leaves a process behind, whose id it prints."""
    code = f"""
import os, subprocess, sys
from tests import processes
processes.mark()
child = subprocess.Popen([sys.executable, "-c", {SLEEP!r}], stdout=subprocess.PIPE, {how})
child.stdout.readline()
left = processes.ended(0.2)
print(child.pid, [one.pid for one in left], left[0].test if left else "")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=scaled(60.0)
    )
    child, _, rest = done.stdout.strip().partition(" ")
    return int(child), rest


def test_a_session_finds_and_kills_what_it_left():
    child, found = session("")
    assert found.startswith(f"[{child}]")
    assert "test_a_session_finds_and_kills_what_it_left" in found  # the test that started it is named
    assert ends(child)


def test_also_one_that_took_no_environment_with_it():
    child, found = session("env={}")
    assert found == f"[{child}]"
    assert ends(child)


ORPHAN = f"""
import subprocess, sys
options = {{"stderr": subprocess.DEVNULL, "start_new_session": True}}
child = subprocess.Popen([sys.executable, "-c", {SLEEP!r}], stdout=subprocess.PIPE, **options)
child.stdout.readline()
print(child.pid, flush=True)
"""


def test_also_one_whose_parent_is_gone():
    done = subprocess.run([sys.executable, "-c", ORPHAN], capture_output=True, text=True, check=True)
    child = int(done.stdout)
    assert child in [one.pid for one in processes.left_over()]
    os.kill(child, signal.SIGKILL)
    assert ends(child)


def test_a_limit_grows_with_the_crowd():
    assert 1.0 <= crowding() <= 20.0
    assert scaled(3.0) >= 6.0
    assert patience(-1.0).over
    assert not patience(60.0).over
