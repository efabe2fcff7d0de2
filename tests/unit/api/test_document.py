from __future__ import annotations

import pytest

from mavcal.service.api.document import OPEN, statuses
from mavcal.service.api.problems import codes

BODY = {"requestBody": {}}


@pytest.mark.parametrize("path", sorted(OPEN))
def test_what_is_told_without_a_key_refuses_no_key(path):
    assert not {401, 429} & set(statuses(path, "get", {}))


@pytest.mark.parametrize(
    ("path", "method", "operation", "has", "lacks"),
    [
        ("/api/v1/vehicles", "get", {}, {401, 403, 429, 500}, {404, 409, 413, 422, 503}),
        ("/api/v1/vehicles/{vehicle_id}", "get", {}, {404}, {409, 503}),
        ("/api/v1/vehicles", "get", {"parameters": [{}]}, {422}, {400, 408, 413}),
        ("/api/v1/vehicles", "get", {"parameters": []}, set(), {422}),
        ("/api/v1/links", "post", BODY, {400, 408, 409, 413, 422, 503, 507}, {404}),
        ("/api/v1/links/{link_id}", "delete", {}, {404, 409, 413, 503, 507}, {400, 408, 422}),
        ("/api/v1/jobs/{job_id}", "get", {}, {404, 409}, {503}),
        ("/api/v1/vehicles/{vehicle_id}/parameters", "get", {}, {404, 409, 503}, {413}),
        ("/api/v1/events", "get", {}, {503}, {409}),
        ("/api/v1/vehicles/{vehicle_id}/samples", "get", {}, {404, 503}, {409}),
        ("/api/v1/fleet.csv", "get", {}, {404, 409}, {503}),
    ],
)
def test_an_operation_says_how_it_can_refuse(path, method, operation, has, lacks):
    found = statuses(path, method, operation)
    assert found == sorted(set(found))
    assert has <= set(found)
    assert not lacks & set(found)


def test_every_status_comes_with_a_code():
    known = frozenset().union(*codes().values())
    for method in ("get", "post"):
        assert set(statuses("/api/v1/jobs/{job_id}/plan", method, {"parameters": [{}], **BODY})) <= known
