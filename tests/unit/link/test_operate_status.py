"""What `annulus head status` and `configure` tell of a head, in units, whatever its level."""

from dataclasses import replace

import pytest

from annulus_pipe.link import operate
from annulus_pipe.link.messages import LEVEL, Command, Configuration, Reply
from annulus_pipe.link.stage import stage_from_us
from annulus_pipe.testing.heads import ScriptedHead, SimulatedHead
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import AnnulusError

STAGE = stage_from_us(
    ratio=4, period_us=40000, exposure_us=38000, readout_us=28000, projector_us=(4500, 5000), led_us=(5750, 2500)
)


def test_a_counter_at_its_end_says_or_more() -> None:
    assert [operate.counted(value) for value in (0, 65_534, 65_535)] == [0, 65_534, "65535 or more"]


def test_what_is_in_force_is_read_back_and_shown_in_microseconds() -> None:
    with SimulatedHead(camera_fps=25.0) as head:
        assert operate.status(head.url)["configuration"] is None
        assert operate.configure(head.url, STAGE)["read_back"] is True
        said = operate.status(head.url)
    assert (said["version"], said["serial_number"], said["level"]) == ("0.1.0", "0000000000000000", LEVEL)
    assert (said["carrier"], said["vbus"], said["interlock"]) == (
        "unknown (VBUS not sensed)",
        "unknown",
        "closed (GP7)",
    )
    assert (said["ratio"], said["configured_period_us"], said["projector_width_us"]) == (4, 40000.0, 5000.0)
    assert (said["image_slot"], said["image"], said["image_in_flash"]) == (0, "confirmed", "whole")
    assert said["host_timeout_ms"] == 500 and said["tolerance_permille"] == 50
    longest_us = said["longest_round_us"]
    assert isinstance(longest_us, float) and 0 <= longest_us < 1000


def test_a_crash_is_told_in_one_line_with_the_boot_it_ended() -> None:
    with SimulatedHead() as head:
        assert operate.status(head.url)["crash"] is None
        head.board.stall_cpu(20_000_000)
        head.run(0.3)
        said = operate.status(head.url)
    assert (said["crashes_since_power_on"], said["boots_since_power_on"], said["crash_pc"]) == (1, 2, None)
    line = str(said["crash"])
    assert line.startswith("stuck in boot 1 of 2, ") and "last command " in line and "\n" not in line


def test_firmware_of_level_1_tells_what_it_has() -> None:
    head = ScriptedHead(ScriptedController(level=1))
    try:
        said = operate.status(head.url)
        configured = operate.configure(head.url, STAGE)
    finally:
        head.close()
    assert said["level"] == 1 and said["board"] == "scripted"
    assert [said[name] for name in ("version", "serial_number", "configuration", "crash")] == [None] * 4
    assert configured["read_back"] is False


def test_a_configuration_that_did_not_take_force_is_one_line() -> None:
    class Forgetful(ScriptedController):
        def _execute(self, command: Command, now: int) -> Reply:
            if isinstance(command, Configuration) and self.in_force is not None:
                self.in_force = replace(self.in_force, led_width=1)
            return super()._execute(command, now)

    head = ScriptedHead(Forgetful())
    try:
        with pytest.raises(AnnulusError, match="not the one asked for: led_width is 1, expected 250000"):
            operate.configure(head.url, STAGE)
    finally:
        head.close()
