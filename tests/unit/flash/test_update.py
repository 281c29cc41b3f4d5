"""From a running head to a flashed one: by PICOBOOT and by the drive, with the controller and the boot ROM scripted."""

import errno
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from boot_rom import Board, Bus
from serial.tools import list_ports
from test_client import far_end, serving
from test_image import program, program_rp2350, uf2, uf2_rp2350
from typer.testing import CliRunner

from annulus_pipe.cli.firmware import app
from annulus_pipe.flash import update
from annulus_pipe.flash.chips import RP2040, RP2350
from annulus_pipe.flash.image import FlashImage, parse_image
from annulus_pipe.flash.update import (
    PRODUCT,
    Controller,
    Flashed,
    board_fields,
    chip_there,
    copy_to_drive,
    find_controllers,
    find_drives,
    flash,
    monitor,
)
from annulus_pipe.link.messages import (
    BOOTLOADER_NEEDS_USB,
    SCHEMA_HASH,
    Bootloader,
    BootloaderReply,
    Command,
    Edge,
    Fault,
    FaultCode,
    Reply,
    StateFlag,
    StatusCode,
    StatusReply,
)
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag, Lamp

IMAGE = parse_image(bytes(uf2(program(2048))), "annulus.uf2")  # says it is commit deadbeef, as the scripted controller


class Head(ScriptedController):
    """Restarts into a boot loader: a board appears on the bus."""

    def __init__(self, bus: Bus, board: Board | None = None, **kinds: int) -> None:
        super().__init__(**kinds)
        self.bus, self.board = bus, board
        self.knows_the_way = True
        self.asked = 0

    def _execute(self, command: Command, now: int) -> Reply:
        if not isinstance(command, Bootloader):
            return super()._execute(command, now)
        self.asked += 1
        status, detail = self.refuse.get(Bootloader, (StatusCode.OK, 0))
        if status is StatusCode.OK and self.board is not None:
            self.bus.boards.append(self.board)
        return BootloaderReply(status, detail)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in {"APPEAR_S": 0.3, "MOUNT_S": 0.5, "TAKE_S": 0.4, "BACK_S": 0.4, "LOOK_S": 0.01}.items():
        monkeypatch.setattr(update, name, seconds)


@pytest.fixture
def usb_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """The head that answers on the line is on this machine's USB as well."""
    monkeypatch.setattr(update, "find_controllers", lambda: [Controller("/dev/ttyACM0", "E6616408438A1C2F", "1-2")])


def one_line(caught: pytest.ExceptionInfo[AnnulusError]) -> str:
    assert "\n" not in str(caught.value)
    return str(caught.value)


# ---- PICOBOOT ----


@pytest.mark.usefixtures("usb_here")
def test_a_running_head_is_asked_into_its_boot_loader_flashed_and_asked_for_its_commit() -> None:
    bystander, board = Board(ports=(1,)), Board(ports=(2,))
    bus = Bus(bystander)
    head = Head(bus, board)
    said: list[str] = []
    with far_end(serving(head)) as port:
        done = flash(IMAGE, port=port, backend=bus, say=said.append)
    assert head.asked == 1
    assert bytes(board.flash[: len(IMAGE.data)]) == IMAGE.data and board.rebooted
    assert set(bystander.flash) == {0x55}  # another board that waited all along is left alone
    assert (done.how, done.where, done.read_back, done.running) == ("picoboot", "1-2", True, "deadbeef")
    assert said == [
        f"{port}: restarting into the boot loader",
        "USB 1-2 (E0C9125B0D9B): boot loader of an RP2040 (Pico)",
    ]


@pytest.mark.usefixtures("usb_here")
def test_a_head_of_another_schema_can_be_flashed() -> None:
    board = Board()
    bus = Bus()
    with far_end(serving(Head(bus, board, schema=SCHEMA_HASH ^ 1))) as port:
        flash(IMAGE, port=port, backend=bus)
    assert board.rebooted


@pytest.mark.usefixtures("usb_here")
def test_a_head_that_is_armed_is_left_alone() -> None:
    bus = Bus()
    head = Head(bus, Board())
    head.refuse[Bootloader] = (StatusCode.BAD_STATE, 0)
    with far_end(serving(head)) as port, pytest.raises(AnnulusError) as caught:
        flash(IMAGE, port=port, backend=bus)
    assert "annulus head disarm" in one_line(caught)


@pytest.mark.usefixtures("usb_here")
def test_a_head_without_usb_is_not_sent_into_silence() -> None:
    bus = Bus()
    head = Head(bus, Board())
    head.refuse[Bootloader] = (StatusCode.BAD_STATE, BOOTLOADER_NEEDS_USB)
    with far_end(serving(head)) as port, pytest.raises(AnnulusError) as caught:
        flash(IMAGE, port=port, backend=bus)
    assert "speaks USB only" in one_line(caught)


@pytest.mark.usefixtures("usb_here")
def test_a_boot_loader_that_does_not_come_up_is_told() -> None:
    bus = Bus(Board(ports=(1,)))
    with far_end(serving(Head(bus))) as port, pytest.raises(AnnulusError) as caught:
        flash(IMAGE, port=port, backend=bus)
    assert "no boot loader came up on USB" in one_line(caught)
    assert not bus.boards[0].rebooted


@pytest.mark.usefixtures("usb_here")
def test_other_firmware_afterwards_is_told() -> None:
    said = b"annulus rp2040 0.1.0 0123abcd protocol 1U schema 0x%08XU\0" % SCHEMA_HASH
    image = parse_image(bytes(uf2(program(said=said))), "new.uf2")
    bus = Bus()
    with far_end(serving(Head(bus, Board()))) as port, pytest.raises(AnnulusError) as caught:
        flash(image, port=port, backend=bus)
    assert "firmware deadbeef answers, expected 0123abcd" in one_line(caught)


def test_without_a_port_the_waiting_board_is_flashed() -> None:
    board = Board()
    done = flash(IMAGE, backend=Bus(board))
    assert board.rebooted and done.running is None


class UsbPort(SimpleNamespace):
    """As pyserial lists it."""

    def __lt__(self, other: SimpleNamespace) -> bool:
        return bool(self.device < other.device)


def on_usb(monkeypatch: pytest.MonkeyPatch, **controllers: str) -> None:
    """These ports are running controllers': port="serial number@place". And there is somebody else's."""
    ports = [UsbPort(device="/dev/ttyUSB0", product="GPS", serial_number="1", location="1-7")]
    for device, serial_at_place in controllers.items():
        serial, place = serial_at_place.split("@")
        ports.append(UsbPort(device=device, product=PRODUCT, serial_number=serial, location=f"{place}:1.0"))
    monkeypatch.setattr(list_ports, "comports", lambda: ports)


def test_the_boot_loader_is_looked_for_where_the_port_was(monkeypatch: pytest.MonkeyPatch) -> None:
    board = Board(ports=(3, 1))
    bus = Bus()
    head = Head(bus, board)
    with far_end(serving(head)) as port:
        on_usb(monkeypatch, **{port: "E661@1-3.1"})
        done = flash(IMAGE, board="E661", backend=bus)  # named by the serial number it has while it runs
        assert (done.where, done.running) == ("1-3.1", "deadbeef")
        head.board = Board(ports=(2,))  # somebody else's comes up elsewhere
        bus.boards.clear()
        with pytest.raises(AnnulusError, match="no boot loader came up"):
            flash(IMAGE, port=port, backend=bus)
        assert not head.board.erased


@pytest.mark.usefixtures("usb_here")
def test_permission_that_comes_a_moment_after_the_board_is_waited_for() -> None:
    board = Board(open_error=errno.EACCES)
    bus = Bus()
    with far_end(serving(Head(bus, board))) as port:
        threading.Timer(0.1, lambda: setattr(board, "open_error", None)).start()
        flash(IMAGE, port=port, backend=bus)
        assert board.rebooted
    denied = Board(open_error=errno.EACCES)
    with far_end(serving(Head(bus := Bus(), denied))) as port, pytest.raises(AnnulusError, match="99-annulus"):
        flash(IMAGE, port=port, backend=bus)


def test_a_controller_that_runs_is_named_when_no_board_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    on_usb(monkeypatch, **{"/dev/ttyACM1": "E662@1-3", "/dev/ttyACM0": "E661@1-2"})
    with pytest.raises(AnnulusError) as caught:
        flash(IMAGE, backend=Bus())
    assert "/dev/ttyACM0 (E661), /dev/ttyACM1 (E662)" in one_line(caught)
    assert find_controllers()[0] == Controller("/dev/ttyACM0", "E661", "1-2")


# ---- the drive ----


@contextmanager
def drive(folder: Path, *, takes: bool = True, board: str = "RPI-RP2") -> Iterator[Path]:
    """A folder that is a board's drive until it has a whole UF2."""
    (folder / "INFO_UF2.TXT").write_text(f"UF2 Bootloader v2.0\nModel: Raspberry Pi RP2\nBoard-ID: {board}\n")
    done = threading.Event()

    def watch() -> None:
        target = folder / "annulus.uf2"
        while takes and not done.wait(0.005):
            if target.exists() and target.stat().st_size == 2 * len(IMAGE.data):
                (folder / "INFO_UF2.TXT").unlink()
                return

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield folder
    finally:
        done.set()
        thread.join()


def test_the_drive_gets_a_uf2_of_the_same_image(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    with drive(tmp_path):
        done = flash(IMAGE, drive=tmp_path, progress=lambda *step: told.append(step))
    assert parse_image((tmp_path / "annulus.uf2").read_bytes(), "copy").data == IMAGE.data
    assert (done.how, done.read_back) == ("drive", False)
    assert told[-1] == ("copying", 4096, 4096)


def test_a_folder_that_is_no_drive_is_not_written_to(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError) as caught:
        copy_to_drive(IMAGE, tmp_path)
    assert "not the drive of an RP2040 (Pico)" in one_line(caught)
    (tmp_path / "INFO_UF2.TXT").write_text("Board-ID: SAMD51\n")
    with pytest.raises(AnnulusError):
        copy_to_drive(IMAGE, tmp_path)
    assert not (tmp_path / "annulus.uf2").exists()


def test_the_wrong_boards_image_is_refused_in_one_line_by_every_way_and_nothing_is_written(tmp_path: Path) -> None:
    told = "an RP2350 (Pico 2), the image is for an RP2040 (Pico)"
    with drive(tmp_path, board="RP2350") as folder:
        with pytest.raises(AnnulusError) as caught:
            copy_to_drive(IMAGE, folder)
        assert told in one_line(caught) and not (folder / "annulus.uf2").exists()
        assert chip_there(drive=folder) is RP2350
    board = Board(product=0x000F)
    with pytest.raises(AnnulusError) as caught:
        flash(IMAGE, backend=Bus(board))
    assert told in one_line(caught) and not board.erased
    head = Head(Bus(), board)
    with far_end(serving(head)) as port:
        assert chip_there(port) is RP2040  # the scripted controller is none of the two: as if it were a Pico
    rp2350 = parse_image(bytes(uf2_rp2350(program_rp2350(2048))), "annulus-rp2350.uf2")
    flash(rp2350, backend=Bus(board))
    assert board.rebooted and bytes(board.flash[:2048]) == rp2350.data


def test_a_drive_that_stays_is_told(tmp_path: Path) -> None:
    with drive(tmp_path, takes=False), pytest.raises(AnnulusError) as caught:
        copy_to_drive(IMAGE, tmp_path)
    assert "did not take it" in one_line(caught)


def test_drives_are_found_among_the_mounts(tmp_path: Path) -> None:
    folder = tmp_path / "RPI RP2"
    folder.mkdir()
    mounts = tmp_path / "mounts"
    spelled = str(folder).replace(" ", "\\040")
    mounts.write_text(f"proc /proc proc rw 0 0\n/dev/sda1 {spelled} vfat rw 0 0\n\n")
    assert find_drives(mounts) == []
    with drive(folder, takes=False):
        assert find_drives(mounts) == [folder]
    assert find_drives(tmp_path / "nothing") == []


# ---- looking and watching ----


def test_who_answers_is_told() -> None:
    with far_end(serving(ScriptedController(schema=SCHEMA_HASH ^ 1))) as port:
        fields = board_fields(port)
    assert (fields["git"], fields["board"], fields["fits_this_host"]) == ("deadbeef", "scripted", False)


def test_a_monitor_tells_events_faults_losses_and_counters() -> None:
    controller = ScriptedController()
    lines = []
    with far_end(serving(controller)) as port:
        for line in monitor(port, 0.3):
            lines.append(line)
            if line["what"] == "counters" and len(lines) < 5:
                edge = Edge(5, 77, 3, Lamp.PROJECTOR, 100, 200, -7, 1, EdgeFlag.FIRST | EdgeFlag.IRREGULAR)
                controller.emit(edge)
                controller.emit(Fault(99, FaultCode.INTERLOCK, 0))
                controller.emit(edge)
    what = [line["what"] for line in lines]
    assert what[0] == "identity" and lines[0]["git"] == "deadbeef"
    edges = [line for line in lines if line["what"] == "edge"]
    assert len(edges) == 2
    assert (edges[0]["edge"], edges[0]["lamp"], edges[0]["odometer"]) == (5, "projector", -7)
    assert edges[0]["flags"] == ["irregular", "first"]
    [fault] = [line for line in lines if line["what"] == "fault"]
    assert fault["fault"] == "interlock"


def test_a_monitors_rates_are_per_second_and_survive_a_counter_that_wraps() -> None:
    def counts(edges: int, events: int) -> StatusReply:
        return StatusReply(
            StatusCode.OK, 0, StateFlag.SYNCED, FaultCode.NONE, 1, edges, 0, 4_000_000, 0, events, 0, 0, 0, 0
        )

    before = counts(2**32 - 20, 65_530)
    assert "edges_per_s" not in update._counters(before, None, 100.0)
    line = update._counters(counts(30, 70), (100.0, before), 102.0)
    assert (line["edges_per_s"], line["events_per_s"], line["bad_frames_per_s"]) == (25.0, 38.0, 0.0)
    assert (line["state"], line["frame_period_us"]) == (["synced"], 40_000.0)
    full = replace(counts(30, 70), late=65_535)
    assert update._counters(full, (100.0, full), 102.0)["late_per_s"] is None  # or more: nobody knows


# ---- the command ----


def annulus(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments))
    if isinstance(result.exception, AnnulusError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def test_an_image_is_described_for_people_and_programs(tmp_path: Path) -> None:
    path = tmp_path / "annulus.uf2"
    path.write_bytes(bytes(uf2(program(2048))))
    said = json.loads(annulus("info", str(path), "--json"))
    assert (said["git"], said["board"], said["bytes"], said["fits_this_host"]) == ("deadbeef", "rp2040", 2048, True)
    assert said["controllers"] == []
    assert "0.1.0" in annulus("info", str(path))
    with pytest.raises(AnnulusError, match="expected one of them"):
        annulus("info", str(path), "--port", "/dev/null")


def test_a_foreign_image_needs_force_and_no_file_says_how_to_build_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "blink.uf2"
    path.write_bytes(bytes(uf2(program(said=b"blink\0"))))
    flashed: list[str] = []

    def instead(image: FlashImage, **_: object) -> Flashed:
        flashed.append(image.name)
        return Flashed(image.name, "", 0, "", "", True, None)

    monkeypatch.setattr(update, "flash", instead)
    with pytest.raises(AnnulusError, match="no annulus firmware"):
        annulus("flash", str(path))
    annulus("flash", str(path), "--force")
    assert flashed == [str(path)]
    monkeypatch.setattr("annulus_pipe.shipped._HERE", tmp_path)
    with pytest.raises(AnnulusError, match="make firmware"):
        annulus("flash")
