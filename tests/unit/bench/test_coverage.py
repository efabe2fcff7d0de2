"""The page of branches: counted by room and by file, and each one that is not taken is there with its reason."""

from __future__ import annotations

from bench.coverage import page

SUMMARY = {"num_branches": 4, "covered_branches": 3}
MEASURED = {
    "files": {
        "service/jobs/a.py": {"summary": SUMMARY, "missing_branches": [[2, 5], [1, -1]]},
        "service/jobs/b.py": {"summary": {"num_branches": 0, "covered_branches": 0}, "missing_branches": []},
        "service/link_registry.py": {"summary": SUMMARY, "missing_branches": [[1, 2]]},
    }
}
READ = {
    "service/jobs/a.py": ["if x | y:", "    while z:"],
    "service/jobs/b.py": [],
    "service/link_registry.py": ["if q:"],
}


def test_rooms_and_files_are_counted_and_others_left_out():
    text = page(MEASURED, {}, READ)
    assert "| service/jobs | 4 | 3 | 75.0 % |" in text
    assert "| service/jobs/a.py | 4 | 3 | 75.0 % |" in text
    assert "b.py" not in text
    assert "links" not in text


def test_a_branch_that_is_not_taken_is_listed_with_its_reason():
    text = page(MEASURED, {"service/jobs/a.py: while z:": "z is a promise of the caller"}, READ)
    assert "| service/jobs/a.py:2 | `while z:` goes to line 5 | z is a promise of the caller |" in text
    assert "| service/jobs/a.py:1 | `if x \\| y:` leaves the function | no test takes it yet |" in text
