"""``mavcal gap selftest``: the diagnosis against effects that were withheld from it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import EXIT_NO, json_option, write_json

if TYPE_CHECKING:
    from mavcal.calib.withheld_check import Check

TIERS = ("T0", "T1", "T2", "T3", "T4", "T5", "T6", "T7", "T10")
AIR_TIERS = ("A0", "A1", "A2", "A3", "A4", "A5", "A6", "A7")
"""Of the airframe; of sensors are those above."""


@click.command()
@click.option(
    "--tier",
    "tiers",
    multiple=True,
    type=click.Choice((*TIERS, *AIR_TIERS)),
    help="Only these tiers, of sensors (T) or of the airframe (A); repeated. [default: all of T]",
)
@click.option("--count", type=click.IntRange(1), default=None, help="Cases a tier. [default: the plan of a full run]")
@click.option("--seed", type=click.IntRange(1), default=1, show_default=True, help="First seed; sealed from 1000000.")
@click.option("--processes", type=click.IntRange(1, 16), default=2, show_default=True)
@click.option("--nested/--not-nested", default=True, show_default=True, help="Selection inside the held-out folds.")
@click.option("--answers", type=click.Path(path_type=Path, dir_okay=False), help="Keep every answer, a JSON line each.")
@click.option("--score-only", is_flag=True, help="Score what --answers holds, run nothing.")
@click.option(
    "--seal", type=click.Path(path_type=Path, dir_okay=False), help="Write the seal of these cases; run none."
)
@json_option
def command(
    *,
    tiers: tuple[str, ...],
    count: int | None,
    seed: int,
    processes: int,
    nested: bool,
    answers: Path | None,
    score_only: bool,
    seal: Path | None,
    as_json: bool,
) -> int:
    """Run cases whose cause is withheld, and score what the diagnosis says of them.

    The cases come from a generator that shares no code with the diagnosis, each from its tier and seed. Exit code 1
    unless the 95 % interval of every figure that has a target meets it.
    """
    from mavcal.calib.withheld_check import check_of, seeds

    if score_only and answers is None:
        raise click.UsageError("--score-only needs --answers FILE")
    chosen = tiers or TIERS
    check = check_of(chosen[0])
    if any(tier not in check.plan for tier in chosen):
        raise click.UsageError("tiers of sensors and of the airframe have seals of their own: run one kind at a time")
    try:
        cases = [(tier, s) for tier in chosen for s in seeds(seed, count or check.plan[tier])]
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    if seal is not None:
        _seal(check, cases, seal, seed)
        return 0
    rows = answers.read_text(encoding="utf-8").splitlines() if score_only and answers else None
    if rows:
        check = check_of(json.loads(rows[0])["label"]["tier"])
    if rows is None:
        rows = _run(cases, answers, nested=nested, processes=processes)
    return _report(check, rows, as_json=as_json)


def _seal(check: Check, cases: Sequence[tuple[str, int]], out: Path, seed: int) -> None:
    from mavcal.calib.withheld_check import labels_sha256

    labels = []
    counts: dict[str, int] = {}
    for tier, s in cases:
        labels.append(check.label(tier, s))
        counts[tier] = counts.get(tier, 0) + 1
        if len(labels) % 100 == 0:
            click.echo(f"{len(labels)} of {len(cases)} labels", err=True)
    document = {
        "generator_sha256": check.generator_sha256(),
        "scorer_sha256": check.scorer_sha256(),
        "first_seed": seed,
        "cases": counts,
        "labels_sha256": labels_sha256(labels),
    }
    out.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def _run(cases: Sequence[tuple[str, int]], out: Path | None, *, nested: bool, processes: int) -> list[str]:
    from mavcal.calib.report import to_json
    from mavcal.service.commands.gap_campaign import Plan, run

    rows: list[str] = []
    with contextlib.ExitStack() as stack:
        kept = None if out is None else stack.enter_context(out.open("w", encoding="utf-8"))

        def record(answer: dict[str, Any]) -> None:
            rows.append(json.dumps(to_json(answer)))
            if kept is not None:
                kept.write(rows[-1] + "\n")
                kept.flush()
            if len(rows) % 20 == 0:
                click.echo(f"{len(rows)} of {len(cases)}", err=True)

        run(Plan(cases, nested, processes), record)
    return rows


def _report(check: Check, rows: Sequence[str], *, as_json: bool) -> int:
    from mavcal.calib.withheld_check import labels_sha256
    from mavcal.service.commands.gap_campaign import answers

    found = answers(rows)
    scores = check.score(found)
    labels = labels_sha256(a.label for a in found)
    diagnosers = sorted({str((a.report.get("inputs") or {}).get("diagnoser_sha256")) for a in found if a.report})
    seal = {"generator_sha256": check.generator_sha256(), "scorer_sha256": check.scorer_sha256()}
    hashes = {**seal, "labels_sha256": labels, "diagnoser_sha256": diagnosers}
    document = {"schema": "gap-selftest/1", "cases": len(rows), **hashes, **scores}
    if as_json:
        write_json(document)
    else:
        _show(document)
    return EXIT_NO if any(f["verdict"] not in (None, "reached") for f in scores["figures"]) else 0


def _show(document: dict[str, Any]) -> None:
    click.echo(f"{document['cases']} cases; generator {document['generator_sha256'][:16]}")
    click.echo(f"diagnosis {', '.join(h[:16] for h in document['diagnoser_sha256'])}")
    for tier, digest in document["labels_sha256"].items():
        click.echo(f"labels {tier:4} {digest}")
    for figure in document["figures"]:
        if figure["n"]:
            click.echo(_line(figure))
    _show_tables(document)
    for tier, rows in document["failures"].items():
        if rows:
            click.echo(f"\nfailures, {tier}")
        for row in rows:
            answers_text = ", ".join(f"{text} x{n}" if n > 1 else text for text, n in row["said"])
            click.echo(f"  {row['wrong']:3}/{row['n']:<3} {row['type']}: {answers_text}; seeds {row['seeds']}")
    for text, n in document["errors"]:
        click.echo(f"error x{n}: {text}")


def _show_tables(document: dict[str, Any]) -> None:
    if document.get("by_severity"):
        click.echo("\nby lambda: detected, top-1, in set, unknown rejected")
    for row in document.get("by_severity", ()):
        shown = _cells(row, "detected", "top1", "in_set", "unknown_rejected")
        click.echo(f"  {row['lambda'][0]:6.0f} - {row['lambda'][1]:4.0f}  {shown}")
    if document.get("by_effect"):
        click.echo("\nby effect: detected, top-1, in set")
    for row in document.get("by_effect", ()):
        click.echo(f"  {row['effect']:20} {_cells(row, 'detected', 'top1', 'in_set')}")
    if document.get("by_probability"):
        click.echo("\nby probability: mean of what was said, share that is right")
    for row in document.get("by_probability", ()):
        stated = "-" if row["mean"] is None else f"{row['mean']:.3f}"
        click.echo(f"  {row['p'][0]:.1f} - {row['p'][1]:.1f}  {stated}  {_cells(row, 'right')}")


def _cells(row: dict[str, Any], *names: str) -> str:
    figures = [row[name] for name in names]
    return "  ".join(f"{f['value']:.3f} ({f['n']})" if f["n"] else "-" for f in figures)


def _line(figure: dict[str, Any]) -> str:
    interval = "" if figure["low"] is None else f" [{figure['low']:.3f}, {figure['high']:.3f}]"
    verdict = {None: "", "reached": "  ok"}.get(figure["verdict"], f"  {str(figure['verdict']).upper()}")
    target = f"  target {figure['target']}" if figure["target"] else ""
    return f"{figure['name']:78} {figure['value']:8.4f}{interval}  n={figure['n']}{target}{verdict}"
