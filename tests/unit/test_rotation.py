"""When a link that stays open goes on in another telemetry log."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from mavcal.service.errors import StoreError
from mavcal.service.link.link import Link
from mavcal.service.retention import Rotation
from mavcal.service.settings import RetentionSettings

SIZE = 2**16


@dataclass
class Recorder:
    position: int
    begun_at: float
    path: Path = Path("a.tlog")


@dataclass
class OpenLink:
    tlog: Recorder
    held: bool = False
    full: bool = False
    rotations: int = 0
    id: str = field(default="link")

    def rotate(self) -> bool:
        if self.full:
            raise StoreError("no space")
        if self.held:
            return False
        self.rotations += 1
        self.tlog = Recorder(0, self.tlog.begun_at + 1e9)
        return True


def looked(*links: OpenLink, now: float = 100.0, **settings: float) -> int:
    """How often the rotation says that a file was begun."""
    told: list[None] = []
    chosen = RetentionSettings.model_validate({"tlog_bytes": SIZE, **settings})
    Rotation(lambda: cast("list[Link]", links), chosen, lambda: told.append(None), clock=lambda: now).look()
    return len(told)


def test_a_large_file_and_an_old_one_are_followed_by_another_and_others_are_not() -> None:
    large, small = OpenLink(Recorder(SIZE, 0.0)), OpenLink(Recorder(SIZE - 1, 0.0))
    assert looked(large, small) == 1
    assert (large.rotations, small.rotations) == (1, 0)
    old, young = OpenLink(Recorder(1, 0.0)), OpenLink(Recorder(1, 3600.0))
    assert looked(old, young, now=7200.0, tlog_hours=2.0) == 1
    assert (old.rotations, young.rotations) == (1, 0)


def test_an_empty_file_is_kept_however_old() -> None:
    empty = OpenLink(Recorder(0, 0.0))
    assert looked(empty, now=1e9) == 0
    assert empty.rotations == 0


def test_a_file_that_a_capture_needs_is_asked_for_again_later() -> None:
    link = OpenLink(Recorder(SIZE, 0.0), held=True)
    assert looked(link) == 0
    link.held = False
    assert looked(link) == 1


def test_a_full_disk_leaves_the_old_file_and_the_other_links_are_looked_at() -> None:
    full, other = OpenLink(Recorder(SIZE, 0.0), full=True), OpenLink(Recorder(SIZE, 0.0))
    assert looked(full, other) == 1
    assert full.tlog.position == SIZE
