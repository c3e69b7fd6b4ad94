"""Claims about the control interface's messages: what is understood comes back equal, all else is one typed error."""

from __future__ import annotations

import base64
import json
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.queue.control_api import (
    MAXIMUM_REQUEST_BYTES,
    CancelJob,
    ControlRequest,
    GetJobs,
    GetStatus,
    Ping,
    RefusedRequestError,
    ResumeQueue,
    StopMotion,
    SubmitInvestigation,
    SubmitRun,
    decode_reply,
    decode_request,
)

REQUESTS: list[ControlRequest] = [
    Ping(),
    GetStatus(),
    GetJobs(limit=3),
    StopMotion(),
    ResumeQueue(confirmed=True),
    CancelJob(job_id="20261121T103000123Z-1"),
    SubmitInvestigation(budget_minutes=4.0, recordings=("a", "b"), settle=("gain",), added_mass=(2.0, 0.0, 0.0, 0.05)),
    SubmitRun(trajectory=b"\x00\xff{}", suffix=".npz", name="ä", periods=3, amplitude=0.25, fit=False, confirmed=True),
]
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@pytest.mark.parametrize("request_", REQUESTS)
def test_a_request_comes_back_as_it_was_sent(request_: ControlRequest) -> None:
    assert decode_request(msgspec.json.encode(request_)) == request_


def test_the_wire_form_is_plain_json_that_other_programs_can_write() -> None:
    text = {"type": "submit", "api": 1, "trajectory": base64.b64encode(b"{}").decode(), "periods": 2}
    request = decode_request(json.dumps(text).encode())
    assert isinstance(request, SubmitRun)
    assert (request.trajectory, request.periods, request.confirmed) == (b"{}", 2, False)


def refusal(data: bytes) -> RefusedRequestError:
    with pytest.raises(RefusedRequestError) as caught:
        decode_request(data)
    return caught.value


@pytest.mark.parametrize("api", [0, 2, -1, 10**30, None])
def test_another_version_is_said_to_be_one(api: int | None) -> None:
    error = refusal(json.dumps({"type": "ping", "api": api}).encode())
    assert error.code in ("unsupported_version", "bad_request")
    assert error.exit_code in (65, 76)
    assert refusal(b'{"type": "ping"}').code == "unsupported_version"
    assert refusal(b'{"type": "new_in_version_2", "api": 2, "more": []}').code == "unsupported_version"


@pytest.mark.parametrize(
    "change",
    [
        {"type": "shutdown"},
        {"type": None},
        {"path": "/etc/passwd"},
        {"periods": 0},
        {"periods": 10**9},
        {"periods": 1.5},
        {"amplitude": 0},
        {"amplitude": 1e-300},
        {"amplitude": 1.0001},
        {"suffix": ".pkl"},
        {"name": "n" * 201},
        {"trajectory": "%%%"},
        {"confirmed": "yes"},
        {"api": True},
        {"api": 1.5},
    ],
)
def test_a_wrong_tag_field_or_value_is_refused(change: dict[str, Any]) -> None:
    good = {"type": "submit", "api": 1, "periods": 2}
    assert refusal(json.dumps({**good, **change}).encode()).code == "bad_request"


@pytest.mark.parametrize("mass", [[-2, 0, 0, 0.05], [2000, 0, 0, 0.05], [2, 0, 0, 50], [2, 0, 0]])
def test_a_mass_that_nobody_fastens_to_a_flange_is_refused(mass: list[float]) -> None:
    request = {"type": "investigate", "api": 1, "job_id": "a", "added_mass": [2, 0, 0, 0.05]}
    decode_request(json.dumps(request).encode())
    assert refusal(json.dumps({**request, "added_mass": mass}).encode()).code == "bad_request"


@pytest.mark.parametrize("job_id", ["../../etc", "a/b", "", "x" * 65, "a b", "é", "a\n"])
def test_a_job_number_is_never_a_path(job_id: str) -> None:
    assert refusal(json.dumps({"type": "cancel", "api": 1, "job_id": job_id}).encode()).code == "bad_request"


def test_deep_nesting_and_size_are_refused() -> None:
    deep = b'{"type":"submit","api":1,"name":' + b"[" * 200_000 + b"]" * 200_000 + b"}"
    assert refusal(deep).code == "bad_request"
    assert refusal(b"[" * 500_000).code == "bad_request"
    assert refusal(b" " * (MAXIMUM_REQUEST_BYTES + 1)).code == "too_long"


@given(st.binary(max_size=2000))
def test_any_bytes_are_one_typed_error_with_a_printable_sentence(data: bytes) -> None:
    assert str(refusal(data)).isprintable()


@given(json_values)
def test_any_json_is_one_typed_error(value: Any) -> None:
    refusal(json.dumps(value).encode())


@given(st.sampled_from(REQUESTS), st.data())
def test_a_damaged_request_is_understood_as_something_allowed_or_refused(
    request_: ControlRequest, data: st.DataObject
) -> None:
    text = bytearray(msgspec.json.encode(request_))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text) - 1))
        text[place : place + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=3))
        if not text:
            break
    try:
        understood = decode_request(bytes(text))
    except RefusedRequestError:
        return
    # Whatever came through obeys every limit: it survives the strict decoder a second time.
    assert decode_request(msgspec.json.encode(understood)) == understood


@given(st.binary(max_size=500))
def test_a_client_is_not_hurt_by_what_answers(data: bytes) -> None:
    with pytest.raises(RefusedRequestError) as caught:
        decode_reply(data)
    assert caught.value.exit_code == 76
