"""``mavcal doctor``: what this machine lacks for the service."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import shutil
import socket
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import click

from mavcal.calib.errors import CalibError
from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.settings import Settings

DISTRIBUTIONS = ("numpy", "scipy", "pymavlink", "fastapi", "uvicorn", "pyserial", "pyulog", "pygeomag")
LEAST_FREE_BYTES = 1024**3


@dataclass(frozen=True)
class DoctorFinding:
    """One thing looked at; `verdict` is pass, warn or fail."""

    id: str
    verdict: str
    text: str


@click.command()
@json_option
def command(as_json: bool) -> int:
    """Check this machine for what the service needs; exit code 1 if something would fail."""
    settings = load_settings()
    findings = [_python(), *_packages(), _data_dir(settings.data_dir), _port(settings), _serial(), _magnetic_model()]
    if as_json:
        write_json({"findings": findings})
    else:
        for finding in findings:
            click.echo(f"{finding.verdict:4}  {finding.id:14}  {finding.text}")
    return EXIT_NO if any(f.verdict == "fail" for f in findings) else 0


def _python() -> DoctorFinding:
    verdict = "pass" if sys.version_info >= (3, 11) else "fail"
    return DoctorFinding("python", verdict, f"Python {platform.python_version()} (3.11 or newer is needed)")


def _packages() -> list[DoctorFinding]:
    findings = []
    for name in DISTRIBUTIONS:
        try:
            findings.append(DoctorFinding(name, "pass", importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            findings.append(DoctorFinding(name, "fail", "not installed: run scripts/setup"))
    return findings


def _data_dir(folder: Path) -> DoctorFinding:
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    if not os.access(existing, os.W_OK):
        return DoctorFinding("data-dir", "fail", f"{existing} cannot be written: set data_dir")
    free = shutil.disk_usage(existing).free
    try:
        with tempfile.TemporaryFile(dir=existing) as probe:
            probe.write(b"mavcal")
    except OSError as error:
        return DoctorFinding("data-dir", "fail", f"{existing}: {error.strerror}: free some space or set data_dir")
    verdict = "pass" if free > LEAST_FREE_BYTES else "warn"
    return DoctorFinding("data-dir", verdict, f"{folder}, {free / 1024**3:.1f} GiB free")


def _port(settings: Settings) -> DoctorFinding:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.host, settings.port))
        except OSError as error:
            return DoctorFinding(
                "port", "warn", f"{settings.host}:{settings.port}: {error.strerror}; choose another --port"
            )
    return DoctorFinding("port", "pass", f"{settings.host}:{settings.port} is free")


def _serial() -> DoctorFinding:
    from serial.tools import list_ports

    ports = [p.device for p in list_ports.comports()]
    closed = [p for p in ports if not os.access(p, os.R_OK | os.W_OK)]
    if closed:
        return DoctorFinding("serial", "warn", f"{', '.join(closed)} may not be opened: join the group dialout")
    return DoctorFinding("serial", "pass", ", ".join(ports) or "no serial port here")


def _magnetic_model() -> DoctorFinding:
    from mavcal.calib.earth import decimal_year, earth_field

    year = decimal_year(datetime.datetime.now(tz=datetime.UTC))
    try:
        field = earth_field(0.0, 0.0, 0.0, year)
    except CalibError as error:
        return DoctorFinding("magnetic-model", "fail", str(error))
    verdict = "pass" if field.valid else "warn"
    return DoctorFinding(
        "magnetic-model", verdict, f"world magnetic model {'covers' if field.valid else 'ended before'} {year:.2f}"
    )
