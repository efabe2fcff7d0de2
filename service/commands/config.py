"""``mavcal config``: the settings in force, their schema, and keys."""

from __future__ import annotations

import asyncio
import getpass
import json
import os
import secrets
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from pydantic import ValidationError
from pydantic_settings import SettingsError

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.settings import ApiKey, Settings

if TYPE_CHECKING:
    from mavcal.service.signing_keys import KnownKey, SigningKeys


@click.group()
def command() -> None:
    """Show the settings in force or their schema, make an API key, or keep keys that sign links."""


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


@command.group()
def signing() -> None:
    """Keys that sign links: an endpoint names one, as udpin:0.0.0.0:14550?signing=NAME."""


_data_dir = click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where the keys are kept.")


@signing.command("list")
@_data_dir
@json_option
def list_keys(data_dir: Path | None, as_json: bool) -> None:
    """Names and fingerprints; a key itself is never shown."""
    keys = _signing_keys(load_settings(data_dir=data_dir)).all()
    if as_json:
        write_json({"signing_keys": [vars(key) for key in keys]})
        return
    for key in keys:
        click.echo(f"{key.name}  {key.fingerprint}  {key.source}")


@signing.command("add")
@click.argument("name")
@_data_dir
@json_option
def add_key(name: str, data_dir: Path | None, as_json: bool) -> None:
    """Keep a key of 64 hexadecimal digits that is read from the standard input, where no other process sees it."""
    given = click.prompt(f"key {name}", hide_input=True, prompt_suffix=": ", err=True)
    known, _ = _kept(load_settings(data_dir=data_dir), lambda keys: keys.add(name, given), "signing key added")
    write_json(vars(known)) if as_json else click.echo(f"{known.name}  {known.fingerprint}")


@signing.command("generate")
@click.argument("name")
@_data_dir
@json_option
def generate_key(name: str, data_dir: Path | None, as_json: bool) -> None:
    """Make a random key and keep it. It is shown once, for whoever else speaks to the vehicle."""
    known, digits = _kept(load_settings(data_dir=data_dir), lambda keys: keys.add(name), "signing key added")
    if as_json:
        write_json({**vars(known), "key": digits})
        return
    click.echo(f"{known.name}  {known.fingerprint}\nkey (shown once): {digits}")


@signing.command("remove")
@click.argument("name")
@_data_dir
@json_option
def remove_key(name: str, data_dir: Path | None, as_json: bool) -> None:
    """Forget a key. A link that names it is not opened any more."""
    gone, _ = _kept(load_settings(data_dir=data_dir), lambda keys: (keys.remove(name), ""), "signing key removed")
    write_json(vars(gone)) if as_json else click.echo(f"{gone.name}  {gone.fingerprint}  removed")


def _signing_keys(settings: Settings) -> SigningKeys:
    from mavcal.service.signing_keys import SigningKeys

    return SigningKeys(settings.data_dir, settings.mavlink)


def _kept(
    settings: Settings, change: Callable[[SigningKeys], tuple[KnownKey, str]], action: str
) -> tuple[KnownKey, str]:
    """Make a change of the keys and put it into the audit trail; only where no service runs, which has its own."""
    from mavcal.service.signing import audit
    from mavcal.service.store import SqliteStore

    store = SqliteStore(settings.data_dir)
    try:
        known, digits = change(_signing_keys(settings))
        asyncio.run(audit(store, getpass.getuser(), action, known))
    finally:
        store.close()
    return known, digits


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
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
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
