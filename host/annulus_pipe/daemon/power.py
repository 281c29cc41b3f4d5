"""What a session holds from power-up to power-down, scan or no scan: line, shared memory, sockets, workers."""

import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import zmq

from annulus_pipe.capture.camera import CameraDriver
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera_feed import CameraFeed
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.control import ControlSocket
from annulus_pipe.daemon.controller_line import ControllerLine, interlock_for, pins_for, preamble_for, stage_of
from annulus_pipe.daemon.observer import Observers
from annulus_pipe.daemon.pools import Pool, socket_folder
from annulus_pipe.daemon.priority import prompt
from annulus_pipe.daemon.publishing import Publishing
from annulus_pipe.daemon.surveying import Surveying
from annulus_pipe.labelling.labelling import CameraMode
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.sensors.sample import Sensor
from annulus_pipe.stream.access import Doorkeeper
from annulus_pipe.stream.frames import CHANNELS
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared

PUBLISHED_S = 2.0  # the publisher has for the last words


@dataclass(frozen=True, slots=True)
class Power:
    """All that is open."""

    line: ControllerLine | None
    shared: Shared
    doorkeeper: Doorkeeper
    control: ControlSocket | None
    publishing: Publishing | None
    surveying: Surveying | None
    feeds: tuple[CameraFeed, ...]  # of the cameras, in the order of head.toml
    modes: tuple[CameraMode, ...]

    @property
    def pools(self) -> dict[str, Pool | None]:
        """Of processes that are there for viewers."""
        return {"publisher": self.publishing, "surveyor": self.surveying}


def power_up(
    config: HeadConfig,
    cameras: Sequence[CameraDriver] | None,
    sensors: Sequence[Sensor],
    account: Account,
    observers: Observers,
    navigation: Navigation,
    stack: ExitStack,
) -> Power:
    """Acquire everything; `stack` gives it back in reverse order. Raises AnnulusError when the head is not there."""
    for camera in cameras or ():
        stack.callback(camera.close)
    for sensor in sensors:
        stack.callback(sensor.close)
    feeds = []
    for number, camera_config in enumerate(config.cameras):  # they open while the controller is talked to
        own = cameras[number] if cameras is not None else None
        feeds.append(CameraFeed(number, camera_config, account, observers, own, config.realtime))
        stack.callback(feeds[-1].close)
    line = None
    if config.port is not None:
        line = ControllerLine(
            config.port,
            stage_of(config),
            account,
            observers,
            preamble_for(config),
            pins_for(config),
            interlock_for(config),
        )
        stack.callback(line.close)
        for event in line.identify():
            navigation.heard(event)
    folder = socket_folder()
    stack.callback(shutil.rmtree, folder, ignore_errors=True)
    ours: zmq.Context[zmq.Socket[bytes]] = prompt(zmq.Context())
    strangers: zmq.Context[zmq.Socket[bytes]] = zmq.Context()  # has threads of its own, which no frame waits for
    for context in (ours, strangers):
        stack.callback(context.destroy, linger=0)
    modes = tuple(_mode(feed, config.lamps.slides) for feed in feeds)
    largest = max(mode.width * mode.height * CHANNELS[mode.encoding] for mode in modes)
    ring = FrameRing(config.slots, largest)  # cameras of several sizes share it: slots are as large as the largest
    stack.callback(ring.close)
    for feed in feeds:
        feed.join(ring, max(1, config.slots // len(feeds)))
    doorkeeper = Doorkeeper(strangers)
    stack.callback(doorkeeper.close)
    shared, publishing, surveying = Shared(ring, ours, folder), None, None
    if config.publish is not None:
        live = config.calibration if config.calibration is not None and config.calibration.frame_by_frame else None
        publishing = Publishing(config.publish, shared, account, observers, config.realtime, live)
        stack.callback(publishing.stop, PUBLISHED_S)
        observers.all.append(publishing)
        stack.callback(observers.all.remove, publishing)
        if live is not None:
            surveying = Surveying(live, shared, account, observers, publishing)
            stack.callback(surveying.stop, 0.0)
            observers.all.append(surveying)
            stack.callback(observers.all.remove, surveying)
    control = None
    if config.control is not None:
        control = ControlSocket(doorkeeper, config.control.address, config.control.keys)
        stack.callback(control.close)
    return Power(line, shared, doorkeeper, control, publishing, surveying, tuple(feeds), modes)


def _mode(feed: CameraFeed, slides: int) -> CameraMode:
    """Raises AnnulusError when the camera is not there."""
    width, height, encoding = feed.look()
    period_ns = round(1e9 / feed.config.timing.fps)
    return CameraMode(feed.number, width, height, encoding, period_ns, slides, feed.config.slides)
