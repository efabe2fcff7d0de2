"""The tables and criteria of the crossed campaign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

from bench.campaign.criteria import Criterion
from bench.campaign.crossed.plan import Network, Process, VehicleFault
from bench.campaign.crossed.report import CrossReport
from bench.campaign.judge import Ending
from bench.campaign.tables import table

LEAST_RUNS = 2000
Facet = Callable[[CrossReport], str]
_FACETS: Sequence[tuple[str, str, Sequence[str], Facet]] = (
    ("network", "network", tuple(Network), lambda r: r.network),
    ("process", "service and its machine", tuple(Process), lambda r: r.process),
    ("vehicle", "vehicle", tuple(VehicleFault), lambda r: r.vehicle),
)
_ENDS = (Ending.VERIFIED, Ending.AS_BEFORE, Ending.FAILURE)


def cross_tables(reports: Sequence[CrossReport]) -> str:
    """By each of the three kinds of fault, by job, and how many cells were met."""
    tables = [_by_facet(reports, *facet) for facet in _FACETS]
    return "\n\n".join([*tables, _by_job(reports), _cells(reports), _cost(reports)])


def _by_facet(reports: Sequence[CrossReport], key: str, title: str, names: Sequence[str], of: Facet) -> str:
    rows = []
    for name in names:
        some = [report for report in reports if of(report) == name]
        struck = sum(report.struck.get(key, False) for report in some)
        rows.append((name, len(some), struck, *_endings(some), sum(r.doubts > 0 for r in some)))
    return table((title, "runs", "struck", *_ENDS, "was in doubt"), rows)


def _by_job(reports: Sequence[CrossReport]) -> str:
    rows = []
    for autopilot, job in sorted({(report.autopilot, report.job) for report in reports}):
        some = [report for report in reports if (report.autopilot, report.job) == (autopilot, job)]
        rows.append((autopilot, job, len(some), *_endings(some), sum(report.resumed for report in some)))
    rows.append(("**all**", "", len(reports), *_endings(reports), sum(report.resumed for report in reports)))
    return table(("autopilot", "job", "runs", *_ENDS, "ended by a second life"), rows)


def _cells(reports: Sequence[CrossReport]) -> str:
    met = {(report.network, report.process, report.vehicle) for report in reports}
    pairs = {pair for n, p, v in met for pair in ((n, p), (p, v), (n, v))}
    all_pairs = len(Network) * len(Process) + len(Process) * len(VehicleFault) + len(Network) * len(VehicleFault)
    cells = len(list(product(Network, Process, VehicleFault)))
    return table(("crossed", "met", "of"), [("pairs", len(pairs), all_pairs), ("cells", len(met), cells)])


def _cost(reports: Sequence[CrossReport]) -> str:
    spent = sorted(report.processor_s for report in reports)
    if not spent:
        return ""
    mean = sum(spent) / len(spent)
    row = (f"{mean:.1f}", f"{spent[len(spent) // 2]:.1f}", f"{spent[-1]:.1f}")
    return table(("processor time of a run, mean (s)", "median", "longest"), [row])


def _endings(reports: Sequence[CrossReport]) -> list[int]:
    return [sum(report.ending == ending for report in reports) for ending in _ENDS]


def of_crosses(reports: Sequence[CrossReport]) -> list[Criterion]:
    """The criteria that the crossed runs must meet."""
    failed = sum(report.ending == Ending.FAILURE for report in reports)
    lost = sum(any("lost" in text or "samples" in text for text in report.complaints) for report in reports)
    wrong = sum(any("journal says" in text for text in report.complaints) for report in reports)
    endless = sum(any("for ever" in text or "never ended" in text for text in report.complaints) for report in reports)
    count = len(reports)
    return [
        Criterion(f"at least {LEAST_RUNS} crossed runs", f"{count}", count >= LEAST_RUNS),
        Criterion("no accepted sample, job or journal entry is lost", f"lost in {lost}", not lost),
        Criterion("every parameter equals what the journal confirms last", f"differs in {wrong}", not wrong),
        Criterion("every job ends, or is resumed and ends", f"{endless} do not", not endless),
        Criterion("every crossed run ends verified or as before", f"{failed} do not", bool(reports) and not failed),
    ]
