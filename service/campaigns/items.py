"""The items of a campaign: one for each vehicle or log, with its outcome."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mavcal.calib.errors import CalibError, InvalidInputError
from mavcal.service.errors import (
    LinkDown,
    PhysicalJobRunning,
    PreflightRunning,
    ServiceError,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleSilent,
    VehicleUnknown,
)
from mavcal.service.jobs.core.codec import from_json, to_json
from mavcal.service.store.rows import ItemRow, JobDocument


class ItemOutcome(StrEnum):
    """What became of an item."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"  # all that was asked for
    WARNED = "warned"  # nothing failed, but a check warns or could not be made
    REVIEW = "review"  # a plan waits to be accepted
    REFUSED = "refused"  # the answer is no: a check failed, the data do not allow the fit, the calibration failed
    SKIPPED = "skipped"  # the vehicle was silent, armed, busy or not there: nothing was begun
    FAILED = "failed"  # it could not be carried out
    IN_DOUBT = "in_doubt"  # a write was interrupted, and what the vehicle holds is not certain
    CANCELLED = "cancelled"


OPEN = frozenset({ItemOutcome.WAITING, ItemOutcome.RUNNING})
"""Outcomes of items still to be processed."""
ABSENT = (VehicleSilent, VehicleUnknown, VehicleArmed, VehicleBusy, VehicleConflict, LinkDown)
TAKEN = (PhysicalJobRunning, PreflightRunning)
"""Errors that mean an unavailable vehicle; such an item is skipped."""


@dataclass(frozen=True)
class Item:
    """One vehicle or log of a campaign. Times are wall-clock seconds since 1970."""

    number: int
    subject: str
    """Id of a vehicle or of an upload, or a file below the campaign's folder."""
    name: str = ""
    """What a person calls it, if that is something else."""
    outcome: ItemOutcome = ItemOutcome.WAITING
    code: str = ""
    """The outcome in one word: the code of a problem, the verdict of a preflight or a diagnosis."""
    text: str = ""
    job_id: str | None = None
    """The job that was begun for it; None: it needed none."""
    began_at: float | None = None
    ended_at: float | None = None
    starts: int = 0
    """Number of starts: more than one if the service was stopped meanwhile."""
    result: Mapping[str, Any] | None = None
    """What was found: ``preflight``, ``fits`` with the digest of the log, or the names of ``documents``."""


@dataclass(frozen=True)
class ItemEnd:
    """How an item ended."""

    outcome: ItemOutcome
    text: str
    code: str = ""
    job_id: str | None = None
    result: Mapping[str, Any] | None = None
    documents: tuple[JobDocument, ...] = ()
    """Kept with the campaign, under names that are the item's own."""


BEGUN_BY = "campaign"
"""Key of a job's context: the campaign that began it, and the number of its item."""


def begun_by(campaign_id: str, item: Item) -> dict[str, Any]:
    """Value of :data:`BEGUN_BY` in the context of a job begun for this item."""
    return {"id": campaign_id, "item": item.number}


_COLUMNS = ("number", "subject", "outcome")


def row_from_item(job_id: str, item: Item) -> ItemRow:
    """The item as the store keeps it."""
    body = to_json(item)
    return ItemRow(job_id, **{name: body.pop(name) for name in _COLUMNS}, body=body)


def item_from_row(row: ItemRow) -> Item:
    """The item of a row; of one that is damaged, what its columns say."""
    known = {name: getattr(row, name) for name in _COLUMNS}
    try:
        return from_json({**row.body, **known}, Item)
    except InvalidInputError:
        outcome = ItemOutcome(row.outcome) if row.outcome in set(ItemOutcome) else ItemOutcome.FAILED
        return Item(row.number, row.subject, outcome=outcome, text="The record of this item is damaged.")


def ended_by(error: ServiceError | CalibError) -> ItemEnd:
    """How an item ends that met this error."""
    code = str(getattr(error, "code", "invalid-input"))
    skipped = isinstance(error, (*ABSENT, *TAKEN))
    return ItemEnd(ItemOutcome.SKIPPED if skipped else ItemOutcome.FAILED, _sentence(str(error)), code)


def of_fits(fits: Sequence[Mapping[str, Any]], method: str, **more: Any) -> ItemEnd:
    """How an item ends whose log was fitted: `fits` as in ``mavcal fit --json``, `more` for its result."""
    refused = [fit for fit in fits if fit["status"] == "refused"]
    plural = "" if len(fits) == 1 else "s"
    texts = [f"{method} fitted {len(fits) - len(refused)} of {len(fits)} sensor{plural}."]
    texts += [f"{fit['sensor']}{fit['instance']}: {_sentence(str(fit['message']))}" for fit in refused]
    outcome = ItemOutcome.REFUSED if refused or not fits else ItemOutcome.DONE
    return ItemEnd(outcome, " ".join(texts), "refused" if refused else "", result={**more, "fits": list(fits)})


def of_diagnosis(
    item: Item, summary: str, report: Mapping[str, Any], documents: Iterable[JobDocument], **more: Any
) -> ItemEnd:
    """How an item ends whose gap was diagnosed, `report` as in ``mavcal gap --json``; documents get its own names."""
    named = tuple(dataclasses.replace(d, name=f"item-{item.number}-{d.name}") for d in documents)
    outcome = ItemOutcome.DONE if report["tested"] else ItemOutcome.REFUSED
    return ItemEnd(
        outcome, summary, str(report["verdict"]), result={**more, "documents": [d.name for d in named]}, documents=named
    )


def _sentence(text: str) -> str:
    text = text[:1].upper() + text[1:]
    return text if not text or text[-1] in ".!?" else f"{text}."
