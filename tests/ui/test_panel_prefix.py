"""The panel behind a real nginx that strips a path prefix, as BlueOS' does."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import pytest

from tests.patience import patience

from .panel import KEPT, service, sim

NGINX = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/bin:/bin")
PREFIX = "/extensionv2/mavcal/"
CONFIG = """
daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/error.log;
events {{}}
http {{
    access_log {folder}/access.log;
    client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
    server {{
        listen 127.0.0.1:{port};
        location {prefix} {{
            proxy_pass {service};
            proxy_http_version 1.1;
            proxy_set_header Host $http_host;
            proxy_read_timeout 600s;
        }}
        location / {{ return 404; }}
    }}
}}
"""
"""With buffering on, which is nginx's own default: event streams have to ask for theirs to pass."""

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(NGINX is None, reason="nginx is not here"),
]


@contextmanager
def proxied(folder: Path, url: str) -> Iterator[str]:
    """nginx on loopback in front of a service: the address of the prefix."""
    folder.mkdir()
    with socket.create_server(("127.0.0.1", 0)) as held:
        port = held.getsockname()[1]
    config = folder / "nginx.conf"
    config.write_text(CONFIG.format(folder=folder, port=port, prefix=PREFIX, service=url))
    command = [str(NGINX), "-p", str(folder), "-e", str(folder / "error.log"), "-c", str(config)]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    address = f"http://127.0.0.1:{port}{PREFIX}"
    try:
        waited = patience(20.0)
        while not answers(f"{address}healthz"):
            assert process.poll() is None, process.stderr.read() if process.stderr else ""
            assert not waited.over, (folder / "error.log").read_text()
            time.sleep(0.05)
        yield address
    finally:
        process.terminate()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


def answers(url: str) -> bool:
    try:
        with urlopen(url):
            return True
    except OSError:
        return False


@pytest.mark.long
def test_behind_a_stripped_prefix_a_job_runs_and_nothing_is_asked_outside_it(desk, tmp_path):
    with (
        service(tmp_path, "--connect", sim(config=KEPT)) as url,
        proxied(tmp_path / "nginx", url) as address,
    ):
        desk.open(address)
        desk.sees("Live", inside=".connection")  # the event stream passes
        desk.calibrate("Gyro").click()
        desk.wait_for_state("Ready for your review", 60)
        desk.sees("Rate at rest is wrong by up to", inside=".headline")
        desk.page.reload()
        desk.sees("Rate at rest is wrong by up to", inside=".headline")
        desk.page.wait_for_selector(".before-after img")
        desk.open(address, "#/setup")
        desk.sees("sim:ardupilot")
        desk.open(f"{address}docs")
        desk.sees("/healthz", inside="#interface")
        outside = [asked for asked in desk.asked if not asked.startswith((address, "data:", "blob:"))]
        assert outside == []
        assert desk.complaints == []


@pytest.mark.long
def test_behind_a_stripped_prefix_no_page_names_an_absolute_address(tmp_path):
    with service(tmp_path) as url, proxied(tmp_path / "nginx", url) as address:
        for page in ("", "docs"):
            with urlopen(f"{address}{page}") as answer:
                text = answer.read().decode()
            assert re.findall(r"""(?:src|href|action)=["'](?:/|https?:)""", text) == [], page
        with urlopen(f"{address}docs") as answer:
            assert answer.url == f"{address}docs"  # no redirect leads out of the prefix
        with urlopen(f"{address}openapi.json") as answer:
            assert b'"servers":[{"url":"."}]' in answer.read().replace(b" ", b"")
