"""The rig against a board: two emulated Picos wired to each other, each with its own crystal, and the command between
them. What it finds of the image is what the image does; a board that is wrong it finds to be so.
"""

import contextlib
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import EMULATOR, ROOT
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.selftest.rig.run import chosen
from tools.mutants import MUTANTS

BENCH = EMULATOR.parent / "bench.mjs"
RIG = ROOT / "firmware/build/rig.uf2"
ALL = range(2, 17)
GATE = "tests/emulator/test_rig.py::test_the_rig_finds_a_flash_exact_between_two_crystals"
JITTER = "no jitter under"


@pytest.fixture(scope="module", autouse=True)
def rig() -> None:
    subprocess.run(["make", "--silent", "-C", str(ROOT / "firmware"), "rig"], check=True, stdout=subprocess.DEVNULL)


@contextlib.contextmanager
def bench(image: Path, *more: str, usb: bool = False) -> Iterator[tuple[str, str]]:
    """Ports of the controller and of the rig."""
    lines = ["--serve-usb", "0", "--serve-rig-usb", "0"] if usb else ["--serve", "0", "--serve-rig", "0"]
    command = ["node", str(BENCH), str(image), str(RIG), *lines, *more]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        told = dict(process.stdout.readline().strip().split(" on ") for _ in range(2))
        controller, rig = (told[name + ("'s USB" if usb else "")] for name in ("controller", "rig"))
        yield controller, rig
    finally:
        process.terminate()
        process.wait(30)


def ask(device: str, rig: str, *more: str) -> tuple[int, str]:
    """Status and everything it printed."""
    result = CliRunner().invoke(app, ["selftest", "rig", "--device", device, "--rig", rig, "--yes", *more])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return 2, str(result.exception)
    return result.exit_code, result.output


def broken(output: str) -> list[str]:
    told, _ = json.JSONDecoder().raw_decode(output[output.index("{") :])
    return [row["what"] for row in told["rows"] if row["verdict"] == "broken"]


def test_the_rig_finds_a_flash_exact_between_two_crystals(image: Path) -> None:
    with bench(image) as ports:
        status, output = ask(*ports, "--only", "a short flash")
    assert status == 0, output
    clock = re.search(r"its clock ([+-][\d.]+)", output)
    assert clock is not None and abs(float(clock[1]) - 37.3) <= 0.3  # ppm: a tick of a span that the host's pace sets
    assert "1 promises kept, none broken, 0 not wired" in output


@pytest.mark.timeout(900)
@pytest.mark.deep(gate=GATE)
@pytest.mark.parametrize("ppm", ["37.3", "-61", "0"])
def test_the_rig_finds_every_promise_kept(image: Path, ppm: str) -> None:
    with bench(image, "--ppm", ppm) as ports:
        status, output = ask(*ports)
    print(output)
    assert status == 0, output
    assert f"{len(chosen(None))} promises kept, none broken, 0 not wired" in output


@pytest.mark.timeout(300)
@pytest.mark.deep(gate=GATE)
def test_the_rig_works_over_usb_on_both_ends(image: Path) -> None:
    with bench(image, usb=True) as ports:
        for only in ("sync edge to lamp", "reset by the host"):  # with which the port goes away, and comes again
            status, output = ask(*ports, "--only", only)
            assert status == 0, output


@pytest.mark.timeout(300)
@pytest.mark.deep(gate=GATE)
@pytest.mark.parametrize(
    ("mutant", "only", "what"),
    [
        ("lamp-one-tick-late", JITTER, "Sync edge to lamp, line flooded, train running"),
        ("lamp-waits-for-sync", JITTER, "Sync edge to lamp, line flooded, train running"),
        ("width-one-tick-long", "shortest flashes", "Shortest flashes, 2 and 3 ticks"),
        ("hold-off-ignored", "glitches", "Glitches and double edges"),
        ("slot-off-by-one", "order of the lamps", "Order of the lamps, ratio 0, 1, 4 and 15"),
        ("chip-of-49-ticks", "codes", "Built-in codes, 0.5 us chips, and their trigger"),
        ("first-step-before-the-driver-wakes", "25 steps", "25 steps of 200 us, then let go"),
        ("arming-the-microwave-drives-the-lamps", "forgets", "A restart forgets the wiring"),
        ("camera-trigger-a-tick-short", "triggers of a camera", "Triggers of a camera, the sync input busy"),
        (
            "second-input-looked-at-by-the-core-alone",
            "either opens",
            "Interlock of two inputs: either opens in a pulse",
        ),
        ("contradiction-cleared-while-open", "contradict", "Two inputs that contradict each other"),
        ("chained-to-channel-0-from-the-start", "a fault after", "A fault after a restart, no burst sent yet"),
    ],
)
def test_a_board_that_breaks_a_promise_is_found(image: Path, tmp_path: Path, mutant: str, only: str, what: str) -> None:
    (fault,) = [m for m in MUTANTS if m.name == mutant]
    firmware = tmp_path / "firmware"
    shutil.copytree(ROOT / "firmware", firmware, ignore=shutil.ignore_patterns("build", "corpus"))
    source = firmware / fault.file
    assert fault.right in source.read_text()
    source.write_text(source.read_text().replace(fault.right, fault.wrong))
    subprocess.run(["make", "--silent", "-C", str(firmware), "image", "GIT=mutant00"], check=True, capture_output=True)
    with bench(firmware / "build/annulus.uf2") as ports:
        status, output = ask(*ports, "--only", only, "--json")
    assert status == 1, output
    assert what in broken(output)


@pytest.mark.timeout(300)
@pytest.mark.deep(gate=GATE)
@pytest.mark.parametrize(
    ("jumpers", "said"),
    [
        ([p for p in ALL if p != 5], "nothing comes of GP5 (pin 7, microwave gate): a jumper is missing"),
        ([p for p in ALL if p != 2], "no edge of GP2 (pin 4, frame sync)"),
        ([p for p in ALL if p != 7], "GP7 (pin 10, interlock): a jumper is missing"),
        (["3-4", "4-3", *(p for p in ALL if p not in (3, 4))], "projector gate) arrives at the rig's GP4"),
        (["5-6", "6-5", *(p for p in ALL if p not in (5, 6))], "microwave gate) arrives at the rig's GP6"),
        (["14-15", "15-14", *(p for p in ALL if p < 14)], "odometer B) are crossed"),
        (["11-12", "12-11", *(p for p in ALL if p not in (11, 12))], "lower end switch) are crossed"),
        (["3-16", "16-3", *(p for p in ALL if p not in (3, 16))], "camera trigger) arrives at the rig's GP3"),
    ],
)
def test_wrong_wiring_is_named_before_anything_is_judged(image: Path, jumpers: list[object], said: str) -> None:
    with bench(image, "--jumpers", ",".join(map(str, jumpers))) as ports:
        status, output = ask(*ports, "--only", JITTER)
    assert status == 2
    assert said in output
    assert "\n" not in output


@pytest.mark.timeout(300)
@pytest.mark.deep(gate=GATE)
def test_eight_jumpers_are_enough_and_what_needs_more_says_so(image: Path) -> None:
    with bench(image, "--jumpers", "2,3,4,5,6,7,8") as ports:
        status, output = ask(*ports, "--only", "direction")
    assert status == 0, output
    assert "needs GP9 (pin 12, DIR)" in output


@pytest.mark.timeout(300)
@pytest.mark.deep(gate=GATE)
def test_ports_the_other_way_round_are_one_clear_line(image: Path) -> None:
    with bench(image) as (controller, rig):
        status, output = ask(rig, controller)
        assert (status, "\n" in output) == (2, False)
        assert "Are the two ports the other way round?" in output
    status, output = ask(controller, rig)  # nobody is there any more
    assert (status, "\n" in output) == (2, False)
    assert "cannot be opened" in output
