from __future__ import annotations

import json
from http import HTTPStatus
from types import SimpleNamespace
from urllib.parse import urljoin

import pytest
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.exceptions import HTTPException
from starlette.requests import Request

from mavcal.calib.errors import CalibError, InvalidInputError, UndeterminedError
from mavcal.service import errors
from mavcal.service.api.dependencies import relative
from mavcal.service.api.problems import codes, explanations, install_problem_handlers, problem
from mavcal.service.errors import AuthError, JobUnknown, ServiceError, StoreError, VehicleArmed
from tests.examples import examples


def request(path="/api/v1/jobs/j", root="", **more):
    app = SimpleNamespace(state=SimpleNamespace(settings=SimpleNamespace(data_dir="/data/of/mine")))
    scope = {"type": "http", "path": path, "raw_path": path.encode(), "root_path": root, "headers": [], "app": app}
    return Request({**scope, "method": "GET", "query_string": b"", "request_id": "r1", **more})


@pytest.fixture
def answered():
    """The response of the application to an exception, and its document."""
    app = FastAPI()
    install_problem_handlers(app)

    async def to(error):
        kind = next(k for k in type(error).__mro__ if k in app.exception_handlers)
        answer = await app.exception_handlers[kind](request(), error)
        return answer, json.loads(answer.body)

    return to


def subclasses(kind):
    return {kind}.union(*map(subclasses, kind.__subclasses__()))


OURS = sorted(subclasses(ServiceError), key=lambda kind: kind.__name__)


@pytest.mark.parametrize("kind", OURS)
async def test_every_error_of_the_service_has_a_document_with_its_code(answered, kind):
    answer, document = await answered(kind("it is so"))
    assert answer.status_code == document["status"] == kind.status_code
    assert (document["code"], document["title"]) == (kind.code, kind.title)
    assert document["detail"].endswith("it is so")
    assert document["type"] == f"../../../problems/{kind.code}"
    assert document["request_id"] == "r1"


def test_no_two_errors_share_a_code_and_every_status_is_one():
    assert len({kind.code for kind in OURS}) == len(OURS)
    assert all(HTTPStatus(kind.status_code) >= 400 for kind in OURS)
    assert {kind for kind in OURS if kind.__module__.startswith(errors.__name__)} == {
        value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, ServiceError)
    }  # each is in the face of the room


def test_an_error_without_a_text_says_what_its_class_says():
    assert str(StoreError()) == StoreError.__doc__
    assert str(JobUnknown("there is no job j")) == "there is no job j"


def test_every_code_is_explained_and_has_its_statuses():
    assert set(codes()) == set(explanations())
    assert list(explanations()) == sorted(explanations())
    for kind in OURS:
        assert codes()[kind.code] == {kind.status_code}
        assert explanations()[kind.code].startswith(f"{kind.title} ({kind.status_code}). ")
        assert kind.__doc__ in explanations()[kind.code]


@pytest.mark.parametrize("kind", [CalibError, InvalidInputError, UndeterminedError])
async def test_what_the_data_do_not_allow_is_invalid_input(answered, kind):
    answer, document = await answered(kind("/data/of/mine/a.bin has no gyro"))
    assert (answer.status_code, document["code"]) == (422, "invalid-input")
    assert document["detail"] == "the data directory/a.bin has no gyro"


async def test_the_place_of_the_data_is_nobodys_business(answered):
    answer, document = await answered(StoreError("/data/of/mine/mavcal.db is damaged"))
    assert (answer.status_code, document["code"]) == (StoreError.status_code, StoreError.code)
    assert "/mavcal.db" in document["detail"]
    assert "/data/of/mine" not in answer.body.decode()


async def test_a_request_without_a_key_is_told_how_to_give_one(answered):
    answer, _ = await answered(AuthError("a key is needed"))
    assert answer.headers["www-authenticate"] == "Bearer"
    answer, _ = await answered(VehicleArmed("it is armed"))
    assert "www-authenticate" not in answer.headers


async def test_an_invalid_request_names_every_field(answered):
    faults = [{"loc": ("body", "options", 0), "msg": "too large"}, {"loc": ("query", "limit"), "msg": "not a number"}]
    _, document = await answered(RequestValidationError(faults))
    assert (document["code"], document["status"]) == ("validation", 422)
    assert document["detail"] == "body.options.0: too large; query.limit: not a number"
    assert document["errors"] == [
        {"field": "body.options.0", "message": "too large"},
        {"field": "query.limit", "message": "not a number"},
    ]


@pytest.mark.parametrize(
    ("status", "code", "detail"),
    [
        (404, "not-found", "Not found (404). There is nothing at this address."),
        (405, "http", "no"),
        (408, "http", "no"),
    ],
)
async def test_an_answer_of_http_has_its_phrase_and_its_headers(answered, status, code, detail):
    answer, document = await answered(HTTPException(status, "no", headers={"Connection": "close"}))
    assert (document["code"], document["detail"]) == (code, detail)
    assert document["title"] == HTTPStatus(status).phrase
    assert answer.headers["connection"] == "close"
    assert status in codes()[code]


def test_a_text_that_is_no_unicode_is_told_all_the_same():
    answer = problem(request(), 422, "validation", "Invalid request", "\udc80 is no letter")
    assert answer.body.isascii()
    assert json.loads(answer.body)["detail"] == "\udc80 is no letter"


@pytest.mark.parametrize(
    ("path", "root", "expected"),
    [
        ("/", "", "target"),
        ("/api", "", "target"),
        ("/api/v1/jobs", "", "../../target"),
        ("/boat/api/v1/jobs", "/boat", "../../target"),
        ("/api/v1/?a=/b/c", "", "../../target"),
    ],
)
def test_an_address_is_relative_to_the_one_that_was_asked_for(path, root, expected):
    assert relative(request(path, root), "target") == expected


SEGMENTS = st.lists(st.text("abc.-", min_size=1).filter(lambda s: s not in {".", ".."}), min_size=1, max_size=6)


@settings(max_examples=examples(40))
@given(SEGMENTS, SEGMENTS, st.lists(st.sampled_from(["mavcal", "x"]), max_size=2))
def test_a_browser_finds_the_target_behind_any_prefix(asked, target, prefix):
    """Resolved as RFC 3986 says, the reference leads from the address of the request to the target of the service."""
    root, path = "".join(f"/{p}" for p in prefix), "/".join(target)
    reference = relative(request(f"{root}/{'/'.join(asked)}", root), path)
    assert urljoin(f"http://h{root}/{'/'.join(asked)}", reference) == f"http://h{root}/{path}"
