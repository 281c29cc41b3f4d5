"""Before a scan: is everything there that it needs, and does it fit together?

Everything is opened as the daemon would open it, one after the other, and given back; nothing is armed, so lamps stay
dark. What fails does not keep the rest from being looked at.
"""

import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import zmq

from annulus_pipe.capture.camera import CameraDriver, EndOfFrames, grab
from annulus_pipe.daemon.about import certificate_state
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.cameras import apply_controls, open_camera
from annulus_pipe.daemon.config import HeadConfig, SocketConfig, load_config
from annulus_pipe.daemon.control import CARRIED_MAX
from annulus_pipe.daemon.controller_line import pins_for
from annulus_pipe.daemon.disk import MB, DiskState, Forecast, free_bytes, require_space
from annulus_pipe.daemon.priority import autogroup_remark, raise_priority
from annulus_pipe.daemon.samples import open_sensors
from annulus_pipe.link import operate
from annulus_pipe.link.client import Client
from annulus_pipe.link.hardware import interlock_line, use_both_inputs
from annulus_pipe.link.messages import InterlockFlag, Polarity, Slides
from annulus_pipe.link.pins import pins_text
from annulus_pipe.link.problems import too_old
from annulus_pipe.qualification.applicability import Applicability
from annulus_pipe.stream.access import Doorkeeper
from annulus_pipe.stream.frames import CHANNELS
from annulus_pipe.vocabulary import AnnulusError

FRAME_S, PERIODS = 5.0, 3.0  # for a camera's first frame; and so many frame periods, where they are long
START_S = 1.0  # for a camera to start, and for its last wait to end
SENSOR_S = 2.0


@dataclass(frozen=True, slots=True)
class CheckRow:
    """One line of the table. `ok` None: there is nothing to be right or wrong."""

    what: str
    ok: bool | None
    text: str


def check_head(path: Path) -> list[CheckRow]:
    """All of it, in the order of a scan's beginning. Waits some seconds for cameras and sensors at most."""
    try:
        config = load_config(path)
    except AnnulusError as error:
        return [CheckRow("head.toml", False, str(error))]
    found = [CheckRow("head.toml", True, str(path))]

    def look(what: str, at: Callable[[], str], without: str = "") -> None:
        if without:
            found.append(CheckRow(what, None, without))
            return
        try:
            found.append(CheckRow(what, True, at()))
        except AnnulusError as error:
            found.append(CheckRow(what, False, str(error)))

    look("calibration", lambda: _calibration(config), "" if config.calibration else "none: nothing is seen live")
    found.append(_certificate(config))
    look(
        "controller",
        lambda: _controller(config.port or "", config.interlock_antivalent),
        "" if config.port else "none: frames have no labels",
    )
    if config.port and (config.inverted or config.lamps.slides > 1):
        look("wiring", lambda: _wiring(config))
    found += _cameras(config)
    look("sensors", lambda: _sensors(config), "" if config.sensors else "none")
    look("recording", lambda: _recording(config), "" if config.record_folder else "none: nothing is recorded")
    for what, socket in (("publish", config.publish), ("control", config.control)):
        look(what, lambda socket=socket, what=what: _socket(what, socket), "" if socket else "none")  # type: ignore[misc]
    look("log", lambda: _log(config.log.file if config.log else Path()), "" if config.log else "none")
    found.append(priority(config.realtime))
    return found


def _calibration(config: HeadConfig) -> str:
    assert config.calibration is not None
    cameras = ", ".join(f"camera {one.id} {one.camera.width}x{one.camera.height}" for one in config.calibration.cameras)
    later = "" if config.calibration.frame_by_frame else "; nothing is seen live: its frames are measured together"
    return cameras + later


def _certificate(config: HeadConfig) -> CheckRow:
    standing, text = certificate_state(config)
    return CheckRow("certificate", None if standing is not Applicability.DOES_NOT else False, text)


def _controller(port: str, antivalent: bool) -> str:
    with Client(port):  # one that may be armed, not only asked
        pass
    inputs = use_both_inputs(port) if antivalent else InterlockFlag(0)
    if (InterlockFlag.OPEN in inputs) != (InterlockFlag.ANTIVALENT_OPEN in inputs) and antivalent:
        raise AnnulusError(f"{port}: the interlock {interlock_line(inputs)}. Expected both alike.")
    status = operate.status(port)
    armed = str(status["state"])
    if "armed" in armed or status["fault"] != "none":
        raise AnnulusError(f"{port}: state is {armed}, fault {status['fault']}, expected a controller at rest")
    return f"{port}: {status['board']}, firmware {status['version'] or status['firmware']}, {armed or 'at rest'}"


def _wiring(config: HeadConfig) -> str:
    """What is inverted, and whether this controller can."""
    pins, port = pins_for(config), config.port or ""
    with Client(port) as client:
        if not client.session.knows(Polarity):
            raise AnnulusError(f"{port}: {too_old(Polarity)}")
        if pins.slides > 1 and not client.session.knows(Slides):
            raise AnnulusError(f"{port}: {too_old(Slides)}")
    resistors = ", ".join(f"GP{pin}" for pin, _ in pins.pulled_up)
    need = f"; 4.7 kohm to 3.3 V at {resistors} keeps them dark through a reset" if resistors else ""
    turns = f"; {pins.slides} slides are lit in turn" if pins.slides > 1 else ""
    return f"inverted: {pins_text(pins.inverted)}{turns}{need}"


def _cameras(config: HeadConfig) -> list[CheckRow]:
    found = []
    for number, wanted in enumerate(config.cameras):
        what = f"camera {number}"
        try:
            camera = open_camera(wanted, number)
            try:
                found.append(CheckRow(what, True, _frame(camera, wanted)))
            finally:
                camera.close()
        except AnnulusError as error:
            found.append(CheckRow(what, False, str(error)))
    return found


def _frame(camera: CameraDriver, wanted: CameraConfig) -> str:
    """A camera that may wait for ever is waited for by a thread."""
    came: list[object] = []
    wait_s = max(FRAME_S, PERIODS * wanted.timing.period_us / 1e6)

    def take() -> None:
        try:
            camera.start()
            came.extend(apply_controls(camera, wanted))
            came.append(_first(camera, time.monotonic() + wait_s))
            camera.stop()
        except (AnnulusError, TimeoutError, EndOfFrames) as error:
            came.append(error)

    thread = threading.Thread(target=take, name="first frame", daemon=True)
    thread.start()
    thread.join(wait_s + START_S)
    last = came[-1] if came and not thread.is_alive() else None
    if last is None or isinstance(last, TimeoutError):
        last = TimeoutError(f"no frame within {wait_s:g} s")
    if not isinstance(last, int):
        raise AnnulusError(f"{wanted.device}: {last}")
    remarks = "".join(f"; {remark}" for remark in came[:-1])
    crop = getattr(camera, "sensor_crop", None)
    shows = "" if crop is None else f", shows {','.join(map(str, crop))} of the sensor"
    return f"{wanted.device}: {camera.width}x{camera.height} {camera.encoding}{shows}, a frame came{remarks}"


def _first(camera: CameraDriver, end_s: float) -> int:
    """The first frame's timestamp; one call of `grab` waits less than the period of a slow camera."""
    while True:
        try:
            return grab(camera).timestamp_ns
        except TimeoutError:
            if time.monotonic() >= end_s:
                raise


def _sensors(config: HeadConfig) -> str:
    """Each that spoke within SENSOR_S. Raises AnnulusError when one did not."""
    with ExitStack() as stack:
        sensors = open_sensors(config.sensors)
        for sensor in sensors:
            stack.callback(sensor.close)
        silent = {number: sensor.name for number, sensor in enumerate(sensors)}
        spoke: set[str] = set()
        end = time.monotonic() + SENSOR_S
        while silent and time.monotonic() < end:
            for number, sensor in enumerate(sensors):
                names = {sample.sensor for sample in sensor.poll()}
                if names:
                    silent.pop(number, None)
                    spoke |= names
            time.sleep(0.01)
    if silent:
        raise AnnulusError(f"{', '.join(silent.values())}: nobody speaks there within {SENSOR_S:g} s")
    return ", ".join(sorted(spoke))


def _recording(config: HeadConfig) -> str:
    folder = config.record_folder
    assert folder is not None
    rate = bytes_per_s(config.cameras)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"annulus")
            file.flush()
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror}). Choose another folder.") from None
    require_space(folder, config.record, rate)
    state: DiskState = Forecast(config.record.reserve_mb * MB).look(free_bytes(folder), 0.0, rate)
    return f"{folder}: {state}"


def bytes_per_s(cameras: Sequence[CameraConfig]) -> float:
    """What they send at most, as colour pictures."""
    return sum(one.width * one.height * one.timing.fps for one in cameras) * max(CHANNELS.values())


def _socket(what: str, socket: SocketConfig | None) -> str:
    assert socket is not None
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    doorkeeper = Doorkeeper(context)
    try:
        address = doorkeeper.bind(context.socket(zmq.ROUTER), socket.address, socket.keys, what, CARRIED_MAX)
    finally:
        doorkeeper.close()
        context.destroy(linger=0)
    return f"{address}, " + (f"{len(socket.keys.viewers)} keys" if socket.keys else "this machine only")


def _log(file: Path) -> str:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("ab"):
            pass
    except OSError as error:
        raise AnnulusError(f"{file}: the log cannot be written ({error.strerror})") from None
    return str(file)


def priority(wanted: bool | None) -> CheckRow:
    """Whether a thread may be real-time. Tried in a thread that ends with it."""
    if wanted is False:
        return CheckRow("priority", None, "not wanted")
    remark: list[str] = []
    thread = threading.Thread(target=lambda: remark.append(raise_priority(True)))
    thread.start()
    thread.join()
    ok = not remark[0] or (False if wanted else None)
    return CheckRow("priority", ok, (remark[0] or "real-time") + autogroup_remark())
