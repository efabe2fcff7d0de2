"""How far a write is proved: the one reading of a :class:`Verification` that outcome, REST and command line share."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mavcal.calib.firmware.plan import ProofVerdict, SensorVerdict, Verification


class ProofLevel(StrEnum):
    """How much of what acts on a stream the stream has proved."""

    FULL = "full"
    PARTIAL = "partial"
    NONE = "none"


_WORDS = {
    ProofVerdict.PROVED: "proved",
    ProofVerdict.CONSISTENT: "agree with it, as their old values would",
    ProofVerdict.NOT_OBSERVABLE: "could not be seen in it",
    ProofVerdict.CONTRADICTED: "contradicted",
}


@dataclass(frozen=True)
class Unproved:
    """A parameter that no stream has proved, or a sensor that could not be seen to read right with the new values."""

    name: str
    verdict: str
    why: str


@dataclass(frozen=True)
class Proof:
    """How far a write is proved, why not further, and what is open."""

    level: ProofLevel
    reason: str
    unproved: tuple[Unproved, ...] = ()


def proof_of(verification: Verification | None) -> Proof:
    """Proof by the physical check; None: there was none."""
    if verification is None:
        return Proof(ProofLevel.NONE, "No stream was checked after the write.")
    acting = [p for p in verification.parameters if p.acts_on_stream]
    if not acting:
        return Proof(ProofLevel.NONE, "No stream can prove the written parameters; all were read back.")
    unproved = [Unproved(p.name, p.verdict.value, p.text) for p in acting if p.verdict != ProofVerdict.PROVED]
    proved = len(acting) - len(unproved)
    counted = [(sum(u.verdict == v for u in unproved), v) for v in ProofVerdict]
    rest = [f"{count} {_WORDS[verdict]}" for count, verdict in counted if count]
    open_sensors = [c for c in verification.sensors if c.verdict != SensorVerdict.RIGHT]
    if open_sensors:
        plural = "" if len(open_sensors) == 1 else "s"
        rest.append(f"{len(open_sensors)} sensor reading{plural} could not be checked")
    unproved += [Unproved(f"{c.id} {c.instance + 1}", c.verdict.value, c.text) for c in open_sensors]
    if not unproved:
        return Proof(ProofLevel.FULL, f"The stream proves all {proved} parameters that act on it.")
    level = ProofLevel.PARTIAL if proved else ProofLevel.NONE
    counted_out = f"{proved} of the" if proved else "none of the"
    reason = f"The stream proves {counted_out} {len(acting)} parameters that act on it; {', '.join(rest)}."
    return Proof(level, reason, tuple(unproved))
