"""Promise of everything that is printed: no text from outside steers the terminal."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from annulus_pipe.cli import main
from annulus_pipe.cli.terminal import as_it_is, escaped

HOSTILE = "\x1b[2J\x1b]0;owned\x07\u202egnp.\x9b31m\r\x08"


def shows(text: str) -> bool:
    return not [
        sign for sign in text if (ord(sign) < 32 and sign not in "\n\t") or 0x7F <= ord(sign) < 0xA0 or sign == "\u202e"
    ]


def test_what_is_printed_is_escaped_and_what_draws_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    with escaped():
        print(f"a\tb {HOSTILE}")
        print(HOSTILE, "ä ± µm", file=sys.stderr)
        as_it_is(sys.stderr).write("\x1b[1mbar")
    print("\x1b after")
    out, error = capsys.readouterr()
    assert out == "a\tb \\x1b[2J\\x1b]0;owned\\x07\\u202egnp.\\x9b31m\\r\\x08\n\x1b after\n"
    assert "ä ± µm" in error and error.endswith("\x1b[1mbar") and shows(error.removesuffix("\x1b[1mbar"))


@pytest.mark.parametrize(
    "arguments",
    [
        ["reconstruct", "{}", "-o", "{}-out"],
        ["daemon", "--config", "{}"],
        ["calibrate", "camera", "{}", "-o", "{}.json"],
    ],
)
def test_a_hostile_name_is_shown_as_it_is_written(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = str(tmp_path / f"scan{HOSTILE}.mcap")
    monkeypatch.setattr(sys, "argv", ["annulus", *(part.format(name) for part in arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    out, error = capsys.readouterr()
    assert ended.value.code != 0 and shows(out + error)


def test_a_name_that_is_no_text_is_shown(tmp_path: Path) -> None:
    name = os.fsencode(tmp_path) + b"/scan\xff\x1b.mcap"
    done = subprocess.run(
        [sys.executable, "-c", "from annulus_pipe.cli import main; main()", "reconstruct", name, "-o", tmp_path],
        capture_output=True,
    )
    assert done.returncode == 1 and b"\\udcff\\x1b.mcap: no such scan" in done.stderr
