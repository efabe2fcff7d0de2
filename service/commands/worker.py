"""``mavcal worker``: computes what the instances of a fleet ask for."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path

import click

from mavcal.service.commands.config import load_settings


@click.command()
def command() -> None:
    """Compute fits and diagnoses for the instances that share a PostgreSQL database, until it is stopped.

    Any number of workers may run, on any machine that has the folder of uploads. The settings name the database
    (`database_url`), the folder (`uploads_dir`), and how many computations run at a time (`limits.file_processes`).
    """
    from mavcal.service.logs import configure_logging
    from mavcal.service.storing import require_fleet

    settings = load_settings()
    configure_logging(as_json=settings.log_json)
    require_fleet(settings)
    from mavcal.service.workers.worker import Worker

    with tempfile.TemporaryDirectory(prefix="mavcal-worker-") as folder:
        asyncio.run(Worker(settings, Path(folder) / "children").run())
