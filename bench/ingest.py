"""Live ingest: what the link takes without loss, whether its own count of losses is true, and what its peer does."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bench.receivers import Received, on_link, on_mavutil
from bench.rows import Row, Section, milliseconds
from bench.sender import Spec

SECONDS = 3.0
MODEST, FAST = 20_000.0, 100_000.0
FAST_LOSS = 0.001
ATTEMPTS = 3
TCP_FRAMES = 300_000
FLOOD_FRAMES = 400_000
SEEDED_LOSS = 0.01
CALM = 2_000.0
"""A fast real link: 3 units at 400 Hz with everything else besides."""
GAPS_S = (0.15, 0.5, 1.5)
"""Lengths of the silences on the way: more than 256 frames even on the calm link."""
REACHED = 0.95
"""A sender that reaches less than this share of its rate does not test the receiver at that rate."""


@dataclass(frozen=True)
class Case:
    """One sender; `most_loss` is the share that may be lost here (None: as much as happens)."""

    name: str
    spec: Spec
    most_loss: float | None
    true_count: bool = True
    """Whether the receiver's own count of losses has to be equal to the truth."""
    peer: bool = False
    attempts: int = 1
    """Other programs on the machine only take away: so often it is tried until the loss is small enough."""


def gaps(rate: float) -> tuple[tuple[int, int], ...]:
    """(first, length) of the silences at this rate, a second and a half apart."""
    found, at = [], 1.5
    for seconds in GAPS_S:
        found.append((int(at * rate), int(seconds * rate)))
        at += seconds + 1.5
    return tuple(found)


def cases() -> tuple[Case, ...]:
    """Everything that is measured."""
    long_enough = sum(GAPS_S) + 1.5 * (len(GAPS_S) + 1)
    return (
        Case(f"UDP {MODEST:.0f} msg/s", Spec("udp", int(MODEST * SECONDS), MODEST), 0.0, peer=True),
        Case(f"UDP {FAST:.0f} msg/s", Spec("udp", int(FAST * SECONDS), FAST), FAST_LOSS, peer=True, attempts=ATTEMPTS),
        Case("TCP unthrottled", Spec("tcp", TCP_FRAMES, 0.0), 0.0, peer=True),
        Case("UDP flood, unthrottled", Spec("udp", FLOOD_FRAMES, 0.0), None),
        Case(
            f"UDP {MODEST:.0f} msg/s, {SEEDED_LOSS:.0%} lost on the way",
            Spec("udp", int(MODEST * SECONDS), MODEST, loss=SEEDED_LOSS),
            0.0,
        ),
        Case(
            f"UDP {CALM:.0f} msg/s, silences of {', '.join(str(n) for _, n in gaps(CALM))} frames on the way",
            Spec("udp", int(CALM * long_enough), CALM, gaps=gaps(CALM)),
            0.0,
        ),
        Case(
            f"UDP {MODEST:.0f} msg/s, silences of {', '.join(str(n) for _, n in gaps(MODEST))} frames on the way",
            Spec("udp", int(MODEST * long_enough), MODEST, gaps=gaps(MODEST)),
            None,
            true_count=False,
        ),
    )


def run() -> Section:
    """Measure every case; the peer right after the link, with the same sender."""
    rows: list[Row] = []
    for case in cases():
        for attempt in range(1, case.attempts + 1):
            ours = on_link(case.spec)
            again = case.most_loss is not None and ours.loss > case.most_loss and attempt < case.attempts
            numbered = case if case.attempts == 1 else replace(case, name=f"{case.name}, run {attempt}")
            rows += link_rows(numbered, ours)
            if not again:
                break
        if case.peer:
            rows.append(peer_row(case, ours, on_mavutil(case.spec)))
    return Section("Live ingest", tuple(rows), NOTES)


NOTES = (
    "Every frame carries a number of 64 bits: the truth is counted from these; the link's own count has nothing but "
    "the 8-bit sequence and what the socket says. The sender is a process of its own with its frames made beforehand. "
    "Lost is what was sent and did not arrive; every frame that arrived is also in the recording on the disk.",
    "Silences on the way are inferred from the sender's rate and the times of arrival, which must be right to 128 "
    "frames: 6 ms at 20 000 msg/s, where no target is set, and 64 ms at 2 000 msg/s. A machine that lets a "
    "process wait longer spoils the count. What the socket itself drops is counted exactly at any rate.",
    f"At {FAST:.0f} msg/s the run is repeated up to {ATTEMPTS} times while too much is lost; every run is listed, and "
    "each missed one counts as missed.",
    "The peer is pymavlink's mavutil.recv_match with its own socket and defaults; it records nothing.",
)


def link_rows(case: Case, ours: Received) -> list[Row]:
    """What the link took, and whether it knows what it did not."""
    reached = "" if not case.spec.rate else f" at {ours.offered_per_s:.0f}/s"
    allowed = {None: "", 0.0: "none lost"}.get(case.most_loss, f"lost <= {case.most_loss or 0.0:.1%}")
    too_slow = bool(case.spec.rate) and ours.sending_rate(case.spec) < REACHED * case.spec.rate
    met = None if case.most_loss is None else ours.loss <= case.most_loss
    took = f"{ours.dropped} of {ours.offered} lost ({ours.loss:.3%}){reached}; {ours.cpu_us:.1f} us of processor each"
    if case.spec.kind == "tcp":
        took += f"; {ours.arrived_per_s:.0f} msg/s"
    if too_slow:
        took += "; the sender did not reach its rate"
    rows = [
        Row(case.name, allowed, took, met),
        Row(
            "- own count of the missing",
            "equal to the truth" if case.true_count else "",
            f"{ours.own_lost} counted, {ours.missing} missing",
            ours.own_lost == ours.missing if case.true_count else None,
        ),
        Row(
            "- recorded",
            "all that arrived",
            f"{ours.recorded} of {ours.arrived}",
            ours.recorded is not None and ours.recorded >= ours.arrived,
        ),
    ]
    if case.peer:
        rows.append(Row("- reader thread -> event loop", "", milliseconds(ours.handoff_s)))
    return rows


def peer_row(case: Case, ours: Received, peer: Received) -> Row:
    """The peer beside the link: what it lost, its own count, and ratios."""
    text = (
        f"{peer.dropped} of {peer.offered} lost ({peer.loss:.1%}), {peer.own_lost} counted; link : mavutil "
        f"arrived {ours.arrived / max(peer.arrived, 1):.2f}, processor time each {ours.cpu_us / peer.cpu_us:.2f}"
    )
    if case.spec.kind == "tcp":
        text += f", msg/s {ours.arrived_per_s / peer.arrived_per_s:.2f}"
    return Row("- mavutil", "", text)
