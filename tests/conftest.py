from __future__ import annotations

import gc
import signal
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

import mavcal.service  # noqa: F401  before numpy is loaded: it keeps numpy to one thread
from tests import examples, processes, sliced
from tests.patience import scaled
from tests.postgres import NoServer, Server

processes.mark()
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a job in the background; tested commands would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_addoption(parser: pytest.Parser) -> None:
    sliced.add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    examples.configure(config)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Before marks are looked at: properties count as long tests; of them all one part, if that was asked for."""
    sliced.leave_most_to_the_night(items)
    if examples.is_long(config):
        examples.choose_properties(items)
    sliced.choose(config, items)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings, which are not part of this repository."""
    if not SHARED.is_dir():
        pytest.skip("the recordings of ../shared/data are not here")
    return SHARED


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection() -> Generator[None, object, object]:
    """Ten thousand tests are made and kept: the garbage collector would go through them again and again for nothing."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000, 20, 20)
        gc.enable()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """A test has its time-out in seconds of an idle machine."""
    marker = item.get_closest_marker("timeout")
    seconds = float(marker.args[0] if marker and marker.args else item.config.getini("timeout") or 0.0)
    if seconds > 0.0:
        item.add_marker(pytest.mark.timeout(scaled(seconds)), append=False)
    return (yield)


@pytest.fixture(scope="session", autouse=True)
def no_process_stays() -> Iterator[None]:
    """What the tests of this process started has ended when they have."""
    yield
    left = processes.ended()
    assert not left, "left running, and killed now: " + "; ".join(map(str, left))


@pytest.fixture(scope="session")
def postgres() -> Iterator[Server]:
    """A PostgreSQL server of this session."""
    try:
        server = Server()
    except NoServer as reason:
        pytest.skip(f"no PostgreSQL: {reason}")
    yield server
    server.stop()


@pytest.fixture
def database_url(postgres: Server) -> str:
    """An empty database."""
    return postgres.database()
