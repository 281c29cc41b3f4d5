"""Promises of the checks for bytes from outside: one line, soon, whatever comes."""

import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe import untrusted
from annulus_pipe.vocabulary import AnnulusError

FORTY = 40


def of_json(data: bytes) -> Any:
    return untrusted.parse_json(data, 1 << 20)


@pytest.mark.parametrize(
    "parse, data, says",
    [
        (of_json, b"[" * 100_000, "deeper than 32"),
        (of_json, b"[" * FORTY + b"]" * FORTY, "deeper than 32"),
        (of_json, b'{"a":' * 20_000, "deeper than 32"),
        (of_json, b'{"a": 1, "b": {"c": 1, "c": 2}}', "'c' is there twice"),
        (of_json, b"[NaN]", "NaN is no number"),
        (of_json, b"[1e999]", "expected a finite one"),
        (of_json, b"9" * 400, "whole number of 1329 bits"),
        (of_json, b"9" * 5000, "4300 digits"),
        (of_json, b"\xff\xfe", "not a text file"),
        (of_json, b'{"a"\n: }', "line 2: not JSON"),
        (of_json, b" " * (1 << 21), "2097152 bytes"),
        (untrusted.parse_toml, b"a = " + b"[" * 60_000, "deeper than 32"),
        (untrusted.parse_toml, b"a = " + b"{a = " * 3000, "deeper than 32"),
        (untrusted.parse_toml, b"a = 0x" + b"f" * 6000, "whole number of 24000 bits"),
        (untrusted.parse_toml, b"a = " + b"9" * 6000, "4300 digits"),
        (untrusted.parse_toml, b"a." * 20_000 + b"a = 1", "line 1: 20000 dots"),
        (untrusted.parse_toml, b"\xff", "not a text file"),
        (untrusted.parse_toml, b"a = \x1b", "not TOML"),
        (untrusted.parse_toml, b"#" * (1 << 17), "131072 bytes"),
        (lambda data: untrusted.unpack(data, 4096), b"\x91" * 900 + b"\xc0", "deeper than 32"),
        (lambda data: untrusted.unpack(data, 4096), b"\x91" * 4000 + b"\xc0", "not one msgpack value"),
        (lambda data: untrusted.unpack(data, 4096), b"\xdd\xff\xff\xff\xff", "not one msgpack value"),
        (lambda data: untrusted.unpack(data, 4096), b"\xc0\xc0", "not one msgpack value"),
    ],
)
def test_what_no_program_writes_is_one_line_and_soon(parse: Callable[[bytes], Any], data: bytes, says: str) -> None:
    before = time.process_time()
    with pytest.raises(ValueError) as caught:
        parse(data)
    assert says in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 300
    assert time.process_time() - before < 2.0


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists, max_leaves=20))
def test_every_check_answers_with_a_value_or_one_line(value: Any) -> None:
    for check in (
        lambda: untrusted.number(value, "x"),
        lambda: untrusted.within(value, "x", 0, 1),
        lambda: untrusted.whole(value, "x", 0, 9),
        lambda: untrusted.numbers(value, "x", (1, 2), 5.0),
        lambda: untrusted.text(value, "x", 5),
        lambda: untrusted.mapping(value, "x"),
    ):
        try:
            check()
        except ValueError as error:
            assert len(untrusted.one_line(str(error))) == len(str(error)) < 300


def test_a_number_too_large_for_a_float_is_none() -> None:
    for check in (lambda value: untrusted.number(value, "x"), lambda value: untrusted.within(value, "x", 0, 1)):
        with pytest.raises(ValueError, match="expected a number"):
            check(10**400)
    with pytest.raises(ValueError, match="thousands of digits"):
        untrusted.whole(10**6000, "x", 0, 9)


@given(st.text())
def test_nothing_that_a_terminal_obeys_is_left(text: str) -> None:
    told = untrusted.printable(text)
    assert not [sign for sign in told if ord(sign) < 32 or 0x7F <= ord(sign) < 0xA0 or 0x202A <= ord(sign) <= 0x202E]
    assert untrusted.printable(told) == told
    told.encode()  # not even halves of surrogates


def test_an_error_is_one_line_whatever_is_quoted_in_it() -> None:
    error = AnnulusError("scan \x1b[2J\x1b]0;owned\x07 \u202egpj.exe\n\udcff" + "x" * 1000)
    assert str(error).startswith(r"scan \x1b[2J\x1b]0;owned\x07 \u202egpj.exe \udcffxx") and len(str(error)) <= 500
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert untrusted.one_line("a" * 600 + "end").endswith("end")
    assert untrusted.one_line("plain: äöü ± 0.1 µm, 3 °C") == "plain: äöü ± 0.1 µm, 3 °C"


def test_a_file_is_bounded_and_a_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345678")
    assert untrusted.read_file(tmp_path / "a", 8) == b"12345678"
    with pytest.raises(ValueError, match="larger than 0 KiB"):
        untrusted.read_file(tmp_path / "a", 7)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="not a file"):  # and does not wait for somebody to write into it
        untrusted.read_file(tmp_path / "pipe", 8)
    with pytest.raises(IsADirectoryError):
        untrusted.read_file(tmp_path, 8)


def test_msgpack_of_our_own_passes() -> None:
    body = {"z_mm": float("nan"), "n": 2**63, "points": b"1234", "list": [[1.5], None, True]}
    assert untrusted.unpack(msgpack.packb(body), 4096)["list"] == body["list"]
