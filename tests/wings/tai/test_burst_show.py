"""`annulus burst show`: the pattern and its timing, for people, programs and pictures."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from annulus_pipe.controller import CODES
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.burst_commands import app


def show(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["show", *arguments], catch_exceptions=True)
    if isinstance(result.exception, AnnulusError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("code", list(CODES))
def test_the_drawing_shows_every_chip_of_a_code(code: str) -> None:
    drawn = "".join(line.split("us  ")[1] for line in show(code).splitlines() if "▁" in line or "█" in line)
    assert drawn == CODES[code].translate({48: "▁", 49: "█"})


def test_json_has_the_numbers() -> None:
    said = json.loads(show("barker13", "--repeat", "3", "--trigger-offset-us", "-2", "--json"))
    assert said["pattern"] == "1111100110101" and said["ok"]
    assert (said["burst_us"], said["period_us"], said["trigger_us"]) == (6.5, 1000.0, [-2.0, 1.0])
    assert said["pulses_us"] == [
        {"start": 0.0, "length": 2.5},
        {"start": 3.5, "length": 1.0},
        {"start": 5.0, "length": 0.5},
        {"start": 6.0, "length": 0.5},
    ]
    assert said["duty"] == pytest.approx(4.5 / 1000)
    assert said["train_s"] == pytest.approx(2.0065e-3)


def test_what_the_controller_would_refuse_ends_with_one_line() -> None:
    with pytest.raises(AnnulusError, match=r"would refuse this: shortest pulse 0\.1 us, expected 0\.3\.\.30 us"):
        show("101", "--chip-us", "0.1")
    with pytest.raises(AnnulusError, match="duty 500 permille, expected 50 permille at most"):
        show("1", "--chip-us", "5", "--period-us", "10")


@pytest.mark.parametrize("suffix, magic", [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_a_picture_is_written_on_request(tmp_path: Path, suffix: str, magic: bytes) -> None:
    show("mpsl25", "-o", str(tmp_path / f"burst.{suffix}"))
    assert (tmp_path / f"burst.{suffix}").read_bytes().startswith(magic)
    with pytest.raises(AnnulusError, match=r"ends in \.png"):
        show("mpsl25", "-o", str(tmp_path / "burst.bmp"))
