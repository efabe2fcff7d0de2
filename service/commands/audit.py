"""``mavcal audit``: check that the audit trail is as it was written."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, json_option, write_json


@click.command()
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where the service keeps everything.")
@json_option
def command(data_dir: Path | None, as_json: bool) -> int:
    """Check the hash chain of the audit trail; exit code 1 if a row was changed, removed or put in.

    The service may go on meanwhile. Keep the digest elsewhere: it vouches for every row up to now.
    """
    from mavcal.service.storing import check_audit_of

    found = check_audit_of(load_settings(data_dir=data_dir))
    if as_json:
        write_json({"intact": found.intact, **asdict(found)})
    elif found.intact:
        click.echo(f"{found.rows} rows, all intact; digest of the newest: {found.head}")
    else:
        click.echo(f"damaged: row {found.broken_at} does not fit the rows before it")
    return 0 if found.intact else EXIT_NO
