"""A real PostgreSQL for the tests: on loopback, in a temporary folder, ended with the session."""

from __future__ import annotations

import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import psycopg

from tests.patience import patience, scaled

_INSTALLED = Path("/usr/lib/postgresql")


class NoServer(Exception):  # noqa: N818 - it says what is the matter
    """Why none can be started here."""


def binary(name: str) -> str:
    """Path of a program of the server."""
    versions = sorted(_INSTALLED.glob(f"*/bin/{name}"), key=lambda path: float(path.parts[-3])) or [None]
    found = shutil.which(name) if versions[-1] is None else str(versions[-1])
    if found is None:
        raise NoServer(f"PostgreSQL is not installed (no {name}): apt-get install postgresql")
    return found


def _as_somebody() -> tuple[list[str], int, int]:
    """How a program is started by a user who is not root, which the server refuses to be."""
    if os.getuid() != 0:
        return [], os.getuid(), os.getgid()
    if shutil.which("setpriv") is None:
        raise NoServer("these tests run as root, and there is no setpriv to start PostgreSQL as somebody else")
    for name in ("postgres", "nobody"):
        try:
            user = pwd.getpwnam(name)
        except KeyError:
            continue
        ids = [f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"]
        return ["setpriv", *ids], user.pw_uid, user.pw_gid
    raise NoServer("these tests run as root, and there is no user to start PostgreSQL as")


class Server:
    """One cluster; :meth:`database` makes an empty database in it."""

    def __init__(self) -> None:
        initdb, postgres = binary("initdb"), binary("postgres")
        somebody, user, group = _as_somebody()
        self._folder = Path(tempfile.mkdtemp(prefix="mavcal-postgres-"))
        self._password = secrets.token_hex(16)
        self._made = 0
        key = self._folder / "key"
        key.write_text(self._password)
        for path in (self._folder, key):
            os.chown(path, user, group)
        data = self._folder / "data"
        how = ["-D", str(data), "-U", "mavcal", "-E", "UTF8", "--locale=C", "-A", "scram-sha-256", "--no-sync"]
        subprocess.run(
            [*somebody, initdb, *how, f"--pwfile={key}"], check=True, capture_output=True, timeout=scaled(60), cwd="/"
        )
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        settings = {
            "listen_addresses": "127.0.0.1",
            "port": str(self.port),
            "unix_socket_directories": str(self._folder),
            "fsync": "off",  # the tests kill processes, not the machine
            "max_connections": "200",
            "shared_buffers": "32MB",
        }
        options = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        begin = somebody or (["setpriv"] if shutil.which("setpriv") else [])
        dies = [*begin, "--pdeathsig=INT"] if begin else []
        self._log = (self._folder / "log").open("wb")
        self._command = [*dies, postgres, "-D", str(data), *options]
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        """Begin to serve, and wait until it does."""
        self._process = subprocess.Popen(self._command, stdout=self._log, stderr=self._log, cwd="/")
        limit = patience(30)
        while True:
            try:
                psycopg.connect(self.url("postgres"), connect_timeout=5).close()
            except psycopg.OperationalError:
                if limit.over or self._process.poll() is not None:
                    raise NoServer((self._folder / "log").read_text(errors="replace")[-500:]) from None
                time.sleep(0.05)
            else:
                return

    def url(self, database: str) -> str:
        """How a database is reached."""
        return f"postgresql://mavcal:{self._password}@127.0.0.1:{self.port}/{database}"

    def database(self, *, template: str | None = None) -> str:
        """The URL of a new database, empty or a copy of another one."""
        self._made += 1
        name = f"test_{self._made}"
        copied = "" if template is None else f" TEMPLATE {template}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}{copied}")
        return self.url(name)

    def kill(self) -> None:
        """End as a crash does, and every connection with it."""
        assert self._process is not None
        self._process.send_signal(signal.SIGQUIT)  # immediate: no checkpoint, recovery at the next start
        self._process.wait(scaled(30))

    def stop(self) -> None:
        """End, and leave nothing behind."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._process.wait(scaled(30))
        self._log.close()
        shutil.rmtree(self._folder, ignore_errors=True)
