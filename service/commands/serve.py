"""``mavcal serve``: the service and its panel."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import json_option, write_json
from mavcal.service.errors import PortBusy
from mavcal.service.loading import loading
from mavcal.service.settings import Settings

if TYPE_CHECKING:
    from fastapi import FastAPI

    from mavcal.service.core import Service

SWITCH_S = 0.001
"""Time slice of the threads that read links, s: Python's 5 ms add up where links are many."""


@click.command()
@click.option("--connect", multiple=True, metavar="URL", help="Endpoint to open at the start; may be given repeatedly.")
@click.option("--host", default=None, help="Address to listen on.  [default: 127.0.0.1]")
@click.option("--port", type=int, default=None, help="Port to listen on; 0 takes a free one.  [default: 8765]")
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--read-only", is_flag=True, default=None, help="Never write to a vehicle, whatever is asked.")
@json_option
def command(
    connect: tuple[str, ...],
    host: str | None,
    port: int | None,
    data_dir: Path | None,
    read_only: bool | None,
    as_json: bool,
) -> None:
    """Run the service and its panel until it is stopped."""
    settings = load_settings(
        connect=connect or None, host=host, port=port, data_dir=data_dir, read_only=read_only or None
    )

    def announce(url: str) -> None:
        if as_json:
            write_json({"ready": True, "url": url})
            sys.stdout.flush()
        else:
            click.echo(f"mavcal listens; the panel is at {url}", err=True)

    serve(settings, announce)


def serve(settings: Settings, announce: Callable[[str], None]) -> None:
    """Run until SIGINT or SIGTERM; `announce` is given the panel's address once requests are answered.

    Raises
    ------
    PortBusy
        If the address cannot be listened on.
    """
    with loading():
        import uvicorn

        from mavcal.service.doorway import Doorway
        from mavcal.service.heap import share_heaps
        from mavcal.service.http import server_config
        from mavcal.service.logs import configure_logging
        from mavcal.service.settings import check_exposure

    share_heaps()
    sys.setswitchinterval(SWITCH_S)
    configure_logging(as_json=settings.log_json)
    check_exposure(settings)
    listener = _listen(settings.host, settings.port)
    host, port = listener.getsockname()[:2]
    shown = "127.0.0.1" if host in {"0.0.0.0", "::"} else host  # noqa: S104 - compared, not bound
    url = f"http://[{shown}]:{port}/" if ":" in shown else f"http://{shown}:{port}/"

    class Server(uvicorn.Server):
        """Answers requests for the page first, then loads and runs the service; errors at that are raised."""

        def __init__(self, doorway: Doorway) -> None:
            super().__init__(server_config(doorway, settings.limits, lifespan="off"))
            self._doorway, self._over = doorway, asyncio.Event()
            self._ending: asyncio.Event | None = None

        async def serve(self, sockets: list[socket.socket] | None = None) -> None:
            with self.capture_signals():
                running = asyncio.create_task(self._run_service(), name="service")
                try:
                    await self._serve(sockets)
                finally:
                    self._over.set()
                    await running

        async def _run_service(self) -> None:
            try:
                app, running_service = await asyncio.to_thread(_load, settings)
                self._ending = app.state.ending
                if self._over.is_set():
                    return
                async with running_service(settings) as service:
                    app.state.service = service
                    self._doorway.open(app)
                    announce(url)
                    await self._over.wait()
            finally:
                self.should_exit = True

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            if self._ending is not None:
                self._ending.set()
            await super().shutdown(sockets)

    signal.signal(signal.SIGTERM, _ended)  # uvicorn raises SIGTERM once more when everything is closed
    with listener:
        Server(Doorway(settings)).run(sockets=[listener])


def _load(settings: Settings) -> tuple[FastAPI, Callable[[Settings], AbstractAsyncContextManager[Service]]]:
    """The application and the runner of its service; loading them takes most of a start."""
    with loading():
        from mavcal.calib.procedures.registry import load_procedures
        from mavcal.service.app import create_app
        from mavcal.service.core import running_service

        load_procedures()
        return create_app(settings), running_service


def _ended(_number: int, _frame: object) -> NoReturn:
    """End a service that was asked to stop with exit code 0, so that its supervisor sees no failure."""
    sys.exit(0)


def _listen(host: str, port: int) -> socket.socket:
    family: Any = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise PortBusy(f"cannot listen on {host}:{port} ({error.strerror}): choose another --host or --port") from error
    listener.set_inheritable(False)
    return listener
