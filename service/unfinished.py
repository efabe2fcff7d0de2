"""Jobs that earlier runs left unfinished on a vehicle, and sentences on them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

from mavcal.calib.firmware.values import shown
from mavcal.service.jobs.core.journal import Sent, as_heard, fold
from mavcal.service.jobs.core.model import Failure, Job, Outcome, Standing
from mavcal.service.jobs.core.states import ENDED, PHYSICAL, WRITING
from mavcal.service.store.sql import Store

UNREAD = "not read since the interruption"


@dataclass(frozen=True)
class Unfinished:
    """A job that claims its vehicle although the run that began it is over."""

    job: Job
    sent: tuple[Sent, ...]
    """Parameters for which a PARAM_SET may have left, from the journal."""
    standing: tuple[Standing, ...]
    """State of each of them as far as it is known."""
    at: float
    """When this state was read, s since 1970; earlier events belong to the run that is over."""

    @property
    def writing(self) -> bool:
        """Whether parameters of the vehicle may be this job's."""
        return self.job.state in WRITING

    @property
    def ended(self) -> bool:
        """Whether nothing of it is in doubt any more."""
        return self.job.state not in PHYSICAL

    @property
    def names(self) -> str:
        """The parameters, as a list in a sentence."""
        return ", ".join(sent.name for sent in self.sent)


def unfinished(store: Store, job: Job) -> Unfinished:
    """The job with what its journal says now."""
    record = fold(store.journal(job.id))
    return Unfinished(job, record.sent, job.standing or as_heard(record, {}, UNREAD), time.time())


def left_over(store: Store, jobs: Iterable[Job]) -> tuple[Unfinished, ...]:
    """The jobs that still claim their vehicle, oldest first."""
    return tuple(unfinished(store, job) for job in jobs if job.state in PHYSICAL)


def beginning(found: Unfinished) -> str:
    """Sentence on the interrupted job and on what happens to it."""
    job = found.job
    if not found.writing:
        return f"job {job.id} ({job.kind}) was interrupted before it wrote anything: it is cancelled"
    wrote = f"while it wrote {found.names}" if found.sent else "before the first parameter was sent"
    return f"job {job.id} ({job.kind}) was interrupted {wrote}: it is finished or taken back first"


def ending(found: Unfinished) -> tuple[str, ...]:
    """Sentences on its end, or on each value in doubt."""
    job = found.job
    if not found.ended:
        why = job.prompt.text if job.prompt is not None else ""
        why = why or (_outcome_text(job.outcome) if isinstance(job.outcome, Failure) else "")
        state = job.state.value.replace("_", " ")
        return (f"job {job.id} ({job.kind}) is {state}{f': {why}' if why else ''}", *map(_doubt, found.standing))
    text = _outcome_text(job.outcome)
    state = job.state.value if job.state in ENDED else f"in {job.state.value}"
    restored = (_restored(sent) for sent in found.sent if sent.session and sent.confirmed is not None)
    return (f"job {job.id} ({job.kind}) is {state}{f'. {text}' if text else ''}", *restored)


def _outcome_text(outcome: Outcome | None) -> str:
    if isinstance(outcome, Failure):
        return " ".join(_sentence(text) for text in (outcome.cause, outcome.remedy) if text)
    return "" if outcome is None else outcome.text


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _restored(sent: Sent) -> str:
    if sent.confirmed == sent.old:
        return f"{sent.name} is back at {shown(sent.old)}"
    return f"{sent.name} holds {shown(sent.confirmed)}; before the job it was {shown(sent.old)}"


def _doubt(s: Standing) -> str:
    intended = f"{s.name}: {shown(s.old)} before, {shown(s.new)} intended"
    if s.value is None:
        return f"{intended}, not heard since"
    certain = "certain" if s.certain else s.note or "uncertain"
    return f"{intended}, last heard as {shown(s.value)} ({certain})"
