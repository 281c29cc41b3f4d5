"""The twin's own tests on the very image a user flashes: pairing under faults, the daemon, and `annulus head`."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import EMULATOR, IMAGE, MS
from typer.testing import CliRunner

from annulus_pipe.capture.photometry import Light, measure
from annulus_pipe.cli.app import app
from annulus_pipe.controller import PIN_ENABLE, PIN_INTERLOCK, PIN_ODOMETER_A, PIN_SYNC
from annulus_pipe.flash.update import enter_boot_loader
from annulus_pipe.record.recording import open_recording
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.twin.emulated import EmulatedBoard
from annulus_pipe.twin.head import head_toml, start_head
from annulus_pipe.twin.soak import soak
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import AnnulusError, Label

pytestmark = pytest.mark.skipif("ANNULUS_IMAGE" in os.environ, reason="another image is being judged, on its pins")

ANNULUS = [sys.executable, "-c", "from annulus_pipe.cli import main; main()"]
LATENCY = 9  # falling edge to lamp, beyond the programmed delay
SYNC_FROM, SYNC_EVERY = 20_000_000, 4_000_000  # emulate.mjs --serve --sync-hz 25
BUSY_MS = 400.0  # further behind than this the head is no judge of a daemon's progress; of its labels it always is
PATIENCE_S = 100.0


# ---- the board ----


@pytest.fixture
def board(image: Path) -> Iterator[EmulatedBoard]:
    with EmulatedBoard(image) as board:
        yield board


def test_the_board_has_the_verbs_of_the_native_one(board: EmulatedBoard) -> None:
    assert board.tick == 30 * MS and 0 < board.boot_tick < 29 * MS
    first = board.boot, board.boot_tick
    board.input(board.tick + MS, PIN_SYNC, 0)
    board.run_until(board.tick + 2 * MS)
    heard = board.serial_read()
    assert heard and board.serial_read() == b""
    assert {int(pin) for pin in board.pins()["pin"]} == {PIN_ENABLE}  # the turntable's is high at rest
    assert board.level(PIN_ENABLE) == 1 and len(board.pins()) == 0
    at = board.tick
    board.power_on()
    board.run_until(at + 30 * MS)
    assert board.boot == (first[0] + 1) % 256 and at < board.boot_tick < at + 29 * MS
    assert set(board.lost().values()) == {0}
    with pytest.raises(AnnulusError, match="refused, now is"):
        board.input(at, PIN_INTERLOCK, 1)
    with pytest.raises(AnnulusError, match="refused"):
        board.input(board.tick + 1, 3, 1)
    board.close()
    with pytest.raises(AnnulusError, match="ended"):
        board.run_until(board.tick + MS)


def test_a_board_that_hangs_on_purpose_restarts_by_its_watchdog(board: EmulatedBoard) -> None:
    before = board.boot
    board.input(board.tick + 10, PIN_ODOMETER_A, 0)
    board.stall_cpu(200 * MS)
    board.run_until(board.tick + 230 * MS)
    assert board.boot == (before + 1) % 256


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AnnulusError, match="make firmware"):
        EmulatedBoard(tmp_path / "none.uf2")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(AnnulusError, match="nodejs"):
        EmulatedBoard()


# ---- pairing ----


@pytest.mark.deep(
    gate="tests/emulator/test_twin_on_image.py::test_a_board_that_hangs_on_purpose_restarts_by_its_watchdog"
)
@pytest.mark.parametrize("faults, frames", [("standard", 600), ("rough", 600)])  # each of three armings has a preamble
def test_no_label_is_wrong_on_the_image_under_faults(image: Path, faults: str, frames: int) -> None:
    result = soak(frames, seed=3, faults=faults, board="emulated")
    assert result["wrong"] == 0
    lit = frames - result["reasons"].get("no flash", 0)  # of a preamble some are dark, and have no label to be given
    assert result["projector"] + result["led"] > 0.9 * lit
    assert result["relock_frames_max"] <= 8
    assert result["link"]["reboots"] == result["rearms"] == 2
    assert result["events_lost_for_good"] == 0
    assert set(result["board_lost"].values()) == {0}
    assert abs(result["clock"]["drift_ppm"] - 35.0) < 20.0


# ---- the daemon ----


@pytest.mark.deep(gate="tests/emulator/test_twin_on_image.py::test_the_board_has_the_verbs_of_the_native_one")
def test_the_daemon_scans_with_the_image_over_tcp(image: Path, tmp_path: Path) -> None:
    world = demo_world(travel_mm=330.0).scaled(416)
    save_calibration(tmp_path / "head-7.json", world.calibration())
    with start_head(world, 6.0, seed=9, board="emulated") as head:
        assert re.fullmatch(r"socket://127\.0\.0\.1:\d+", head.port_url)
        more = '[record]\nfolder = "scans"\n[workers]\ncount = 1\n'
        (tmp_path / "head.toml").write_text(head_toml(head, world, Path("head-7.json")) + "\n" + more)
        daemon = subprocess.Popen(
            [*ANNULUS, "daemon", "--config", str(tmp_path / "head.toml")], stderr=subprocess.PIPE, text=True
        )
        assert daemon.stderr is not None
        heard, enough, end = [], False, time.monotonic() + PATIENCE_S
        for line in daemon.stderr:
            heard.append(line)
            enough = line.startswith("scanning: ") and int(line.split()[1]) >= 24
            if enough or time.monotonic() > end:
                daemon.send_signal(signal.SIGINT)
                break
        heard += daemon.stderr.readlines()
        status, counters = daemon.wait(30), head.counters()
    late_ms = max(counters["behind_ms"], counters["stretched_ms"])
    if not (enough and status == 0) and late_ms > BUSY_MS:
        pytest.skip(f"this machine is too busy: the emulated board fell {late_ms:.0f} ms behind")
    assert enough and status == 0, heard
    assert counters["lamps_on"] == []
    (path,) = (tmp_path / "scans").glob("*.mcap")
    recording = open_recording(path)
    expected = {Label.PROJECTOR: Light.PROJECTOR, Label.LED: Light.LED}
    labelled = [frame for frame in recording.frames if frame.label in expected]
    assert not recording.torn and len(labelled) >= 24
    wrong = [f.index for f in labelled if measure(recording.read_raw(f)[0]).light is not expected[f.label]]
    assert wrong == []


# ---- annulus head ----


class Served:
    """The image behind TCP in real time, a sync edge every 40 ms; its pins from the VCD it leaves."""

    def __init__(self, vcd: Path) -> None:
        self.vcd = vcd
        self.process = subprocess.Popen(
            ["node", str(EMULATOR), str(IMAGE), "--serve", "0", "--sync-hz", "25", "--vcd", str(vcd)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.port = self.process.stdout.readline().split()[-1]

    def annulus(self, *arguments: str) -> str:
        """What the command prints. AnnulusError when it ends with one line and status 1."""
        done = CliRunner().invoke(app, [*arguments, "--port", self.port])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        assert done.exit_code == 0, done.output
        return done.stdout

    def pins(self) -> dict[str, list[tuple[int, int]]]:
        """End it; (tick, level) of every output by name."""
        self.process.terminate()
        self.process.wait(10)
        names: dict[str, str] = {}
        pins: dict[str, list[tuple[int, int]]] = {}
        tick = 0
        for line in self.vcd.read_text().splitlines():
            if line.startswith("$var"):
                names[line.split()[3]] = line.split()[4]
            elif line.startswith("#"):
                tick = int(line[1:])
            elif line[:1] in ("0", "1") and tick > 0:
                pins.setdefault(names[line[1:]], []).append((tick, int(line[0])))
        return pins


@pytest.fixture
def served(image: Path, tmp_path: Path) -> Iterator[Served]:
    served = Served(tmp_path / "run.vcd")
    yield served
    served.process.kill()
    served.process.wait()


def pulses(changes: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """(rise, width) of every pulse."""
    rises = [tick for tick, level in changes if level == 1]
    falls = [tick for tick, level in changes if level == 0]
    return [(rise, fall - rise) for rise, fall in zip(rises, falls, strict=True)]


@pytest.mark.deep(gate="tests/emulator/test_twin_on_image.py::test_the_board_has_the_verbs_of_the_native_one")
def test_head_commands_do_to_the_pins_what_they_say(served: Served) -> None:
    who = json.loads(served.annulus("head", "status", "--json"))
    assert (who["board"], who["fault"]) == ("rp2040", "none")
    info = json.loads(served.annulus("firmware", "info", "--json"))
    assert info["git"] == who["firmware"] and info["fits_this_host"]
    timing = ["--fps", "25", "--exposure-us", "38000", "--readout-us", "28000"]
    lamps = ["--projector-width-us", "4000", "--led-delay-us", "3000", "--led-width-us", "1000.5", "--ratio", "1"]
    configure = ["head", "configure", *timing, *lamps, "--projector-delay-us"]
    with pytest.raises(AnnulusError, match="leaves the window"):
        served.annulus(*configure, "500")
    assert json.loads(served.annulus(*configure, "2500", "--json"))["window_closes_us"] == 12_000
    armed = served.annulus("head", "arm", "--hold", "1")
    counted = {name: int(n) for n, name in re.findall(r"(\d+) (projector|led)", armed)}
    fired = served.annulus("head", "burst", "--code", "barker13", "--repeat", "5", "--period-us", "1000", "--json")
    assert json.loads(fired)["bursts"] == 5
    served.annulus("head", "burst", "--code", "1001", "--chip-us", "1", "--trigger-offset-us", "-2")
    with pytest.raises(AnnulusError, match="duty"):
        served.annulus("head", "burst", "--code", "single", "--chip-us", "20", "--period-us", "100")
    said = [
        json.loads(line) for line in served.annulus("firmware", "monitor", "--seconds", "1.2", "--json").splitlines()
    ]
    assert {line["what"] for line in said} >= {"identity", "counters", "edge"}
    assert all(line["lamp"] == "dark" for line in said if line["what"] == "edge")
    assert "cleared: none" in served.annulus("head", "clear")
    served.annulus("head", "disarm")
    state = json.loads(served.annulus("head", "status", "--json"))
    assert "armed" not in state["state"] and state["edges_rejected"] == 0
    with pytest.raises(AnnulusError, match="speaks USB only"):
        enter_boot_loader(served.port)
    served.annulus("head", "status")

    pins = served.pins()
    projector, led = pulses(pins["projector"]), pulses(pins["led"])
    last = max(projector[-1], led[-1])  # which disarming may cut
    assert {width for rise, width in projector if rise != last[0]} == {400_000}
    assert {width for rise, width in led if rise != last[0]} == {100_050}
    assert last[1] <= 400_000
    assert {(rise - SYNC_FROM) % SYNC_EVERY for rise, _ in projector} == {250_000 + LATENCY}
    assert {(rise - SYNC_FROM) % SYNC_EVERY for rise, _ in led} == {300_000 + LATENCY}
    assert projector and led and abs(len(projector) - len(led)) <= 1
    assert abs(counted["projector"] - len(projector)) <= 1 and abs(counted["led"] - len(led)) <= 1
    gate, trigger = pulses(pins["microwave"]), pulses(pins["trigger"])
    assert [width for _, width in gate] == [250, 100, 50, 50] * 5 + [100, 100]
    starts = [rise for rise, width in gate if width == 250]
    assert [later - starts[0] for later in starts] == [100_000 * i for i in range(5)]
    assert [rise - trigger[i][0] for i, rise in enumerate(starts)] == [0] * 5
    assert gate[-2][0] - trigger[-1][0] == 200 and gate[-1][0] - gate[-2][0] == 300
    assert {width for _, width in trigger} == {100}


@pytest.mark.deep(
    gate="tests/emulator/test_twin_on_image.py::test_a_board_that_hangs_on_purpose_restarts_by_its_watchdog"
)
def test_the_command_updates_a_head_through_its_uart(served: Served, other: Path) -> None:
    before = json.loads(served.annulus("firmware", "info", "--json"))
    done = json.loads(served.annulus("firmware", "flash", str(other), "--json"))
    assert (done["how"], done["where"], done["running"]) == ("line", served.port, "0therone")
    after = json.loads(served.annulus("firmware", "info", "--json"))
    assert (after["git"], after["boot_cause"]) == ("0therone", "host_reset")
    assert before["git"] != after["git"]
