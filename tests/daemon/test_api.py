"""Claims about the messages between processes: they survive JSON, and nothing malformed gets through."""

from __future__ import annotations

import json
import os
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.api import LoopReport, RunRequest
from daemon.control_messages import (
    MAXIMUM_CONTROL_BYTES,
    RecorderFailed,
    RecorderFinished,
    RecorderProgress,
    RecorderReady,
    RecorderTrouble,
    decode_control,
)
from daemon.errors import ConfigurationError, DaemonError, MissingInputError
from daemon.json_files import read_json, write_bytes_atomically, write_json

REQUEST = RunRequest(run_id="r", robot="iiwa14", table_file="/t.npy", trajectory_file="/t.json", out_dir="/o")

counts = st.integers(0, 2**53)
text = st.text(max_size=30)
control_messages = st.one_of(
    st.builds(RecorderReady, part=counts),
    st.builds(RecorderProgress, part=counts, samples=counts),
    st.builds(
        RecorderFinished,
        part=counts,
        samples=counts,
        samples_in_periods=counts,
        last_index=counts,
        sequence_gaps=counts,
        handover_gaps=counts,
    ),
    st.builds(RecorderTrouble, part=counts, sentence=text, reserve_opened=st.booleans()),
    st.builds(RecorderFailed, part=counts, sentence=text),
)


@given(message=control_messages)
def test_control_messages_come_back_as_they_went(message: object) -> None:
    assert decode_control(msgspec.json.encode(message)) == message  # type: ignore[arg-type]


@given(data=st.binary(max_size=300))
def test_random_bytes_on_the_control_socket_give_the_typed_error_only(data: bytes) -> None:
    with pytest.raises(msgspec.DecodeError):
        decode_control(data)


@given(message=control_messages, place=st.integers(0, 500), value=st.integers(0, 255))
def test_mutated_control_messages_give_a_message_or_the_typed_error(message: object, place: int, value: int) -> None:
    data = bytearray(msgspec.json.encode(message))  # type: ignore[arg-type]
    data[place % len(data)] = value
    try:
        decode_control(bytes(data))
    except msgspec.DecodeError:
        return


def test_an_endless_control_message_is_refused() -> None:
    with pytest.raises(msgspec.DecodeError):
        decode_control(b" " * (MAXIMUM_CONTROL_BYTES + 1))
    with pytest.raises(msgspec.DecodeError):
        decode_control(b"[" * 50_000)


def test_request_and_report_survive_a_file(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    write_json(file, REQUEST)
    assert read_json(file, RunRequest) == REQUEST
    report = LoopReport(outcome="stopped", reason="GUARD", sentence="…", joint=4, value=1.5, limit=1.2)
    write_json(file, report)
    assert read_json(file, LoopReport) == report


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("{", "truncated"),
        (json.dumps({"run_id": "r"}), "robot"),
        (json.dumps({**msgspec.to_builtins(REQUEST), "perods": 3}), "perods"),
        (json.dumps({**msgspec.to_builtins(REQUEST), "periods": "many"}), "periods"),
        ("\xff\xfe", ""),
    ],
)
def test_a_bad_request_file_is_refused_with_file_and_field(tmp_path: Path, content: str, word: str) -> None:
    file = tmp_path / "request.json"
    file.write_bytes(content.encode("latin-1"))
    with pytest.raises(ConfigurationError) as caught:
        read_json(file, RunRequest)
    assert caught.value.exit_code == 78
    assert str(file) in str(caught.value)
    assert word in str(caught.value)


def test_an_absent_request_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError) as caught:
        read_json(tmp_path / "no.json", RunRequest)
    assert caught.value.exit_code == 66


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("periods", 0),
        ("bind_port", 70000),
        ("amplitude", 1.5),
        ("amplitude", 0.0099),
        ("amplitude", float("nan")),
        ("table_period_s", 0.0),
        ("receive_timeout_s", float("inf")),
        ("lead_in_s", -1.0),
        ("lead_in_s", float("nan")),
        ("ring_slots", 300),
        ("ring_slots", 10**14),
    ],
)
def test_a_request_out_of_range_names_its_field(field: str, value: float) -> None:
    with pytest.raises(ConfigurationError) as caught:
        RunRequest(**{**msgspec.structs.asdict(REQUEST), field: value})
    assert caught.value.field == field


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "status.json"
    write_bytes_atomically(file, b"old")

    def refuse(source: str, target: str) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="No space"):
        write_bytes_atomically(file, b"new")
    assert file.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["status.json"]


def test_every_error_has_an_exit_code_of_the_contract() -> None:
    def tree(kind: type[DaemonError]) -> list[type[DaemonError]]:
        return [kind, *(each for child in kind.__subclasses__() for each in tree(child))]

    # 1: done, and the answer is no (the ladder refuses an amplitude before its turn).
    assert {kind.exit_code for kind in tree(DaemonError)} <= {1, 65, 66, 69, 70, 74, 76, 78}
