"""What is checked before a campaign through uploads begins, and what it goes through."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.service.campaigns.begin import CampaignDesk
from mavcal.service.campaigns.campaigns import CampaignTask
from mavcal.service.errors import RecordingUnknown
from mavcal.service.store.rows import RecordingRow

UPLOADS = [RecordingRow(f"r{k}", 1.0, f"flight {k}.bin", Path(f"/up/r{k}"), 1, "ab", {}) for k in range(4)]


class Desk:
    """A desk whose campaigns and checks are noted; uploads are there if they are among these."""

    def __init__(self):
        self.begun, self.checked = [], []
        self.desk = CampaignDesk(SimpleNamespace(begin=self.begin), SimpleNamespace(check=self.check))

    async def begin(self, task, options, subjects, *, attended):
        self.begun.append((task, options, subjects, attended))
        return "job"

    def check(self, upload, method=None):
        self.checked.append((upload, method))
        if upload not in {row.id for row in UPLOADS}:
            raise RecordingUnknown(f"there is no recording {upload}")
        if method == "no-such":
            raise InvalidInputError("there is no method")


@pytest.fixture
def made():
    return Desk()


async def test_every_upload_is_fitted_under_its_name(made):
    assert await made.desk.fit(UPLOADS, None, "gyro-rest", {"instance": 1}, at_once=2) == "job"
    options = {"method": "gyro-rest", "options": {"instance": 1}, "at_once": 2}
    named = [(row.id, row.name) for row in UPLOADS]
    assert made.begun == [(CampaignTask.FIT, options, named, False)]
    assert made.checked == [("r0", "gyro-rest")]  # they are there; the method is looked at once


async def test_uploads_that_are_named_must_all_be_there(made):
    await made.desk.fit(UPLOADS, ("r2", "r0"), "gyro-rest", {})
    assert made.begun[0][2] == [("r2", "flight 2.bin"), ("r0", "flight 0.bin")]
    with pytest.raises(RecordingUnknown):
        await made.desk.fit(UPLOADS, ("r0", "gone"), "gyro-rest", {})
    assert len(made.begun) == 1


@pytest.mark.parametrize(
    ("method", "options"),
    [("no-such", {}), ("gyro-rest", {"from": float("nan")}), ("gyro-rest", {"a": [float("inf")]})],
)
async def test_what_cannot_be_computed_begins_nothing(made, method, options):
    with pytest.raises(InvalidInputError):
        await made.desk.fit(UPLOADS, None, method, options)
    assert made.begun == []


async def test_what_uploads_are_compared_with_is_not_diagnosed_itself(made):
    await made.desk.gap(UPLOADS, None, "r1", ["r3"], at_once=1)
    [(task, options, subjects, _)] = made.begun
    assert (task, options) == (CampaignTask.GAP, {"sim": "r1", "nominal": ["r3"], "at_once": 1})
    assert [upload for upload, _ in subjects] == ["r0", "r2"]


async def test_an_upload_that_is_named_is_diagnosed_whatever_it_is_compared_with(made):
    await made.desk.gap(UPLOADS, ("r1", "r0"), "r1", [])
    assert [upload for upload, _ in made.begun[0][2]] == ["r1", "r0"]
    assert made.begun[0][1]["sim"] == "r1"


@pytest.mark.parametrize(("sim", "nominal"), [("gone", []), (None, ["r1", "gone"])])
async def test_what_is_compared_with_must_be_there(made, sim, nominal):
    with pytest.raises(RecordingUnknown):
        await made.desk.gap(UPLOADS, None, sim, nominal)
    assert made.begun == []
