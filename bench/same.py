"""``python -m bench.same BEFORE AFTER``: do two folders of answers say the same, and how far apart are they where not.

For a change that may not change an answer: keep the answers of some cases, make them again, compare.
Files are matched by their path below the folder; ``.jsonl`` holds an answer a line. Exit code 1: something differs.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

IGNORED = ("seconds", "diagnoser_sha256")
"""Keys that differ from run to run, or from version to version, and say nothing about the answer."""
_SHOWN = 5
"""Differences of one answer that are printed."""


@dataclass(frozen=True)
class Tolerance:
    """How far two numbers may be apart: by a part of the larger one, or by so much in all."""

    relative: float = 0.0
    absolute: float = 0.0

    def holds(self, difference: Difference) -> bool:
        """Whether a difference is within it; one that is no distance of two numbers never is."""
        return difference.relative <= self.relative or difference.distance <= self.absolute


@dataclass(frozen=True)
class Difference:
    """Two values at one place of an answer.

    `distance` and `relative` are those of two finite numbers, the latter in parts of the larger one; else infinite.
    """

    place: str
    before: str
    after: str
    distance: float = math.inf
    relative: float = math.inf

    @property
    def text(self) -> str:
        """One line."""
        apart = f" (relative {self.relative:.2g})" if math.isfinite(self.relative) else ""
        return f"{self.place or 'the whole'}: {self.before} -> {self.after}{apart}"


@dataclass(frozen=True)
class Compared:
    """One answer: what differs beyond the tolerance, and the largest difference of two numbers within it."""

    name: str
    beyond: tuple[Difference, ...]
    within: Difference | None

    @property
    def same(self) -> bool:
        """Whether nothing differs beyond the tolerance."""
        return not self.beyond


def differences(before: Any, after: Any, ignored: Collection[str] = IGNORED, place: str = "") -> Iterator[Difference]:
    """Every place at which two JSON values differ; keys that are `ignored` are left out wherever they are."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in dict.fromkeys((*before, *after)):
            if key in ignored:
                continue
            inner = f"{place}.{key}" if place else str(key)
            if key in before and key in after:
                yield from differences(before[key], after[key], ignored, inner)
            else:
                yield Difference(inner, _said(before, key), _said(after, key))
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield Difference(place, f"{len(before)} entries", f"{len(after)} entries")
        for k, (one, other) in enumerate(zip(before, after, strict=False)):
            yield from differences(one, other, ignored, f"{place}[{k}]")
    elif (found := _of_leaves(before, after, place)) is not None:
        yield found


def _said(values: Mapping[str, Any], key: str) -> str:
    return _short(values[key]) if key in values else "nothing"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _of_leaves(before: Any, after: Any, place: str) -> Difference | None:
    """The difference of two values that are not both objects, nor both lists; None: they are the same."""
    if not (_is_number(before) and _is_number(after)):
        same = type(before) is type(after) and before == after
        return None if same else Difference(place, _short(before), _short(after))
    if before == after or (math.isnan(before) and math.isnan(after)):
        return None
    if not (math.isfinite(before) and math.isfinite(after)):
        return Difference(place, repr(before), repr(after))
    distance = abs(before - after)
    return Difference(place, repr(before), repr(after), distance, distance / max(abs(before), abs(after)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def compared(name: str, before: Any, after: Any, tolerance: Tolerance, ignored: Collection[str] = IGNORED) -> Compared:
    """One answer from before and after."""
    beyond: list[Difference] = []
    within: Difference | None = None
    for found in differences(before, after, ignored):
        if not tolerance.holds(found):
            beyond.append(found)
        elif within is None or found.relative > within.relative:
            within = found
    return Compared(name, tuple(beyond), within)


def answers_in(folder: Path) -> dict[str, Any]:
    """Every answer below a folder by its name.

    Raises
    ------
    ValueError
        If a file is no JSON, or there is no answer at all.
    """
    found: dict[str, Any] = {}
    for path in sorted(p for p in folder.rglob("*") if p.suffix in (".json", ".jsonl")):
        name = path.relative_to(folder).as_posix()
        try:
            if path.suffix == ".json":
                found[name] = json.loads(path.read_text(encoding="utf-8"))
                continue
            for k, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
                found[f"{name}:{k}"] = json.loads(line)
        except ValueError as error:
            raise ValueError(f"{path} is no JSON: {error}") from error
    if not found:
        raise ValueError(f"{folder} has no answer (.json, .jsonl)")
    return found


def lines_of(one: Compared) -> Iterator[str]:
    """What is printed of one answer."""
    if not one.same:
        yield f"{one.name}: DIFFERS at {len(one.beyond)} {'place' if len(one.beyond) == 1 else 'places'}"
        yield from (f"    {found.text}" for found in one.beyond[:_SHOWN])
        if len(one.beyond) > _SHOWN:
            yield f"    and {len(one.beyond) - _SHOWN} more"
    elif one.within is None:
        yield f"{one.name}: the same to the last digit"
    else:
        yield f"{one.name}: the same within the tolerance; largest difference at {one.within.text}"


def main(argv: Sequence[str] | None = None) -> int:
    """Compare, print a line an answer, and a summary. Exit code 1: something differs, or is in one folder alone."""
    parser = argparse.ArgumentParser(prog="python -m bench.same", description=__doc__)
    parser.add_argument("before", type=Path, help="folder of answers")
    parser.add_argument("after", type=Path, help="the same answers, made again")
    parser.add_argument("--relative", type=float, default=0.0, help="numbers may differ by this part of the larger one")
    parser.add_argument("--absolute", type=float, default=0.0, help="and by this much in all")
    parser.add_argument("--but", action="append", default=list(IGNORED), metavar="KEY", help="leave KEY out; repeated")
    given = parser.parse_args(argv)
    try:
        before, after = (answers_in(folder) for folder in (given.before, given.after))
    except ValueError as error:
        parser.error(str(error))
    shared = [name for name in before if name in after]
    lacking = sorted(before.keys() ^ after.keys())
    for name in lacking:
        print(f"{name}: only in {given.before if name in before else given.after}")
    tolerance = Tolerance(given.relative, given.absolute)
    found = [compared(name, before[name], after[name], tolerance, given.but) for name in shared]
    for one in found:
        print("\n".join(lines_of(one)))
    same = sum(one.same for one in found)
    print(f"{same} of {len(found) + len(lacking)} answers are the same")
    return 0 if found and same == len(found) + len(lacking) else 1


if __name__ == "__main__":
    sys.exit(main())
