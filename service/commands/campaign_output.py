"""Follows a campaign on the command line and prints what became of its items."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, write_json, writing
from mavcal.service.commands.screen import Screen

_LOOK_S = 0.1
_MOST_SHOWN = 20


@dataclass(frozen=True)
class OutputOptions:
    """How the outcome is printed."""

    table: Path | None = None
    """File of the CSV; None: none."""
    as_json: bool = False


@dataclass(frozen=True)
class CampaignSnapshot:
    """State of a campaign at one instant, as JSON."""

    id: str
    state: str
    options: Mapping[str, Any]
    outcome: Mapping[str, Any] | None
    progress: Mapping[str, Any] | None = None


async def followed(look: Callable[[], Awaitable[CampaignSnapshot]], screen: Screen) -> CampaignSnapshot:
    """Wait until the campaign stops, with its progress on `screen`; its last snapshot."""
    from mavcal.service.jobs.core.states import ENDED

    while (snapshot := await look()).state not in ENDED:
        if snapshot.progress is not None:
            screen.progress(snapshot.progress)
        await asyncio.sleep(_LOOK_S)
    return snapshot


def print_campaign(
    snapshot: CampaignSnapshot, items: Sequence[Mapping[str, Any]], output: OutputOptions, screen: Screen
) -> int:
    """Print a campaign that has ended; its exit code."""
    outcomes = [item["outcome"] for item in items]
    if output.as_json:
        about = {name: getattr(snapshot, name) for name in ("id", "state", "options", "outcome")}
        write_json({**about, "counts": Counter(outcomes), "items": items})
    else:
        open_still = [item for item in items if item["outcome"] != "done"]
        for item in open_still[:_MOST_SHOWN]:
            screen.line(f"    {item['outcome']:10}{item['name'] or item['subject']}: {item['text']}")
        if len(open_still) > _MOST_SHOWN:
            more = len(open_still) - _MOST_SHOWN
            screen.line(f"    {more} more are not done: `mavcal campaign items {snapshot.id}` lists them")
    outcome = snapshot.outcome or {"kind": "result", "text": ""}
    failed = outcome["kind"] != "result"
    text = f"{outcome['cause']} {outcome['remedy']}" if failed else outcome["text"]
    screen.line(f"{snapshot.state}: {text}", bold=True)
    return EXIT_NO if failed else exit_code(snapshot.options, outcomes)


def exit_code(options: Mapping[str, Any], outcomes: Iterable[str]) -> int:
    """0: every item is done, or waits in review as asked. 3: some preflights warn. 1: something else is not done."""
    good = {"done"} if options.get("apply") else {"done", "review"}
    left = set(outcomes) - good
    return 0 if not left else EXIT_PART if left == {"warned"} else EXIT_NO


def write_table(path: Path, text: str, count: int) -> None:
    """Write the outcome of so many items as CSV."""
    with writing(path):
        path.write_text(text, encoding="utf-8", newline="")
    click.echo(f"{path}: {count} items", err=True)
