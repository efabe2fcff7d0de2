"""``mavcal config``: the settings in force, their schema, and new keys."""

from __future__ import annotations

import json
import os
import secrets
import tomllib
from typing import Any

import click
from pydantic import ValidationError
from pydantic_settings import SettingsError

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.settings import ApiKey, Settings


@click.group()
def command() -> None:
    """Show the settings in force, their schema, or make an API key."""


@command.command()
@json_option
def show(as_json: bool) -> None:
    """The settings in force; secrets are not shown."""
    document = json.loads(load_settings().model_dump_json())
    if as_json:
        write_json(document)
        return
    for name, value in _flat(document):
        click.echo(f"{name} = {json.dumps(value)}")


@command.command()
@json_option
def schema(as_json: bool) -> None:
    """The JSON schema of ``mavcal.toml``."""
    document = Settings.model_json_schema()
    write_json(document) if as_json else click.echo(json.dumps(document, indent=2))


@command.command()
@click.option("--name", required=True, help="Who will hold the key.")
@click.option(
    "--scope", multiple=True, default=("read",), show_default=True, help="read, operate, write-params, admin."
)
@click.option("--tag", multiple=True, help="Only vehicles with one of these tags are seen and touched; none: all.")
@json_option
def key(name: str, scope: tuple[str, ...], tag: tuple[str, ...], as_json: bool) -> None:
    """Make an API key: the key once, and the lines for ``mavcal.toml`` that let it in."""
    from mavcal.service.api.security import Scope, digest

    unknown = set(scope) - {s.value for s in Scope}
    if unknown:
        raise click.BadParameter(f"no scope {', '.join(sorted(unknown))}; there are {', '.join(Scope)}")
    token = secrets.token_urlsafe(32)
    entry = {"name": name, "sha256": digest(token), "scopes": sorted(scope)} | ({"tags": sorted(tag)} if tag else {})
    try:
        ApiKey.model_validate(entry)
    except ValidationError as error:
        raise click.UsageError("; ".join(e["msg"] for e in error.errors())) from None
    if as_json:
        write_json({"key": token, "entry": entry})
        return
    click.echo(f"key (shown once): {token}\n\n[[api_keys]]")
    for field, value in entry.items():
        click.echo(f"{field} = {json.dumps(value)}")


def load_settings(**overrides: Any) -> Settings:
    """The settings with `overrides` from the command line; None means not given.

    Raises
    ------
    click.UsageError
        Naming every setting that is unknown or out of range.
    """
    unknown = sorted(name for name in os.environ if _unknown_setting(name))
    if unknown:
        raise click.UsageError(
            f"{', '.join(unknown)} in the environment is no setting (`mavcal config schema` lists them)"
        )
    try:
        return Settings(**{k: v for k, v in overrides.items() if v is not None})
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(str(p) for p in e['loc'])}: {e['msg']}" for e in error.errors())
        raise click.UsageError(f"the settings are not valid: {faults} (`mavcal config schema` lists them)") from None
    except SettingsError as error:
        raise click.UsageError(f'{error}: lists in the environment are JSON, as ["udpin:0.0.0.0:14550"]') from None
    except tomllib.TOMLDecodeError as error:
        raise click.UsageError(f"mavcal.toml is not valid TOML: {error}") from None
    except OSError as error:
        raise click.UsageError(f"mavcal.toml cannot be read: {error.strerror}") from None


def _unknown_setting(name: str) -> bool:
    """A mistyped MAVCAL_READ_ONLY must not pass unnoticed."""
    upper = name.upper()
    return (
        upper.startswith("MAVCAL_")
        and upper.removeprefix("MAVCAL_").split("__")[0].lower() not in Settings.model_fields
    )


def _flat(document: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in document.items():
        rows += _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else [(prefix + name, value)]
    return rows
