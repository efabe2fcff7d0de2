"""``python -m bench.realdata``: fit every recording of ../shared/data with a known answer, exit 1 if one differs.

Known answers are certificates, published values, or least-squares fits made independently of this project: none is an
exact truth. Ours agrees if it lies within what the known answer is good for, plus two standard deviations of ours.
"""

from __future__ import annotations

import sys

from bench.realdata import inertial, others
from bench.realdata.finding import table
from bench.realdata.recordings import DATA


def main() -> int:
    """Exit code 2: the recordings are not here."""
    if not DATA.is_dir():
        print(f"the recordings are not here: {DATA}", file=sys.stderr)
        return 2
    found = [*inertial.findings(), *others.findings()]
    print(f"{table(found)}\n\n{len(found)} answers, {sum(f.agrees for f in found)} agree")
    return 0 if all(f.agrees for f in found) else 1


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(__doc__)
    sys.exit(main())
