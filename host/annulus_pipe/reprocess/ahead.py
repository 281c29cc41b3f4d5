"""All loops of a head's method compiled before anybody waits for them: by a drawn scan, taken through the whole method.

    make_ready(calibration, print)        # one line, and a minute, where nothing was compiled yet; nothing otherwise

It is done in a process of its own: one that is about to be real-time need not load what it will never call, and several
workers that start together would each compile the same.
"""

import contextlib
import ctypes
import fcntl
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric import compiling
from annulus_pipe.numeric.telling import telling
from annulus_pipe.reprocess.method import method_for
from annulus_pipe.reprocess.warmup import warmup_frame
from annulus_pipe.scans.scan import ScanFrame
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import survey
from annulus_pipe.wall.texture import LedFrame

FRAMES, STEP_MM = 12, 3.0  # as many as a survey needs to do all its work
GREY = 90
USUAL = "slits-1"  # what a head needs that has one camera beside a slide of rings
LOOK_S = 0.1


def work_of(calibration: Calibration) -> str:
    """What a head needs compiled, by name: heads of one kind need the same."""
    return f"{calibration.kind}-{len(calibration.cameras)}"


def is_ready(calibration: Calibration) -> bool:
    return not calibration.frame_by_frame or compiling.is_ready(work_of(calibration))


def make_ready(calibration: Calibration, say: Callable[[str], None], stop: Callable[[], bool] = lambda: False) -> None:
    """Returns when all is compiled, or `stop()` says so. `say` is given one line if that takes longer than a moment.

    A head whose frames are measured together (fringes) is left to the moment it is measured: it has no frame to draw.
    """
    if is_ready(calibration):
        return
    if compiling.folder() is None:
        say(compiling.NOWHERE)
        return
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_in_a_child, args=(calibration, there, os.getpid()), name="compiling", daemon=True)
    child.start()
    there.close()
    try:
        while not stop():
            if here.poll(LOOK_S):
                say(here.recv())
    except EOFError:  # done, or it failed: then the method will say why
        child.join()
    finally:
        child.kill()
        child.join()
        here.close()


def make_ready_beside(calibration: Calibration) -> None:
    """The same for a worker of a cluster, of which several may begin on one machine: one of them has it compiled, in a
    program of its own, and the others wait.

    A loop that was compiled in this very process may call what it uses as that was compiled by itself, not as it was
    built into it: the last bit of a pose is then another. Loops that come from where they are kept are all the same.
    Raises AnnulusError where they cannot be kept.
    """
    if not calibration.frame_by_frame:
        return
    kept = compiling.folder()
    if kept is None:
        raise AnnulusError(compiling.NOWHERE)
    if is_ready(calibration):
        return
    with (kept / f"ahead-{work_of(calibration)}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not is_ready(calibration):
            program = [
                sys.executable,
                "-c",
                "from annulus_pipe.reprocess.ahead import _beside; _beside()",
                str(os.getpid()),
            ]
            subprocess.run(program, input=json.dumps(calibration.to_dict()), text=True, check=False)


def compile_all(calibration: Calibration) -> None:
    """In this process: a drawn scan to its survey. Of a head whose own cannot be drawn, or make no wall, that of one of
    its kind, which calls the same loops: what is wrong with a calibration is the scan's to say, not the warm-up's."""
    try:
        _compile(calibration)
    except AnnulusError:
        _compile(_usual(calibration.kind))
    compiling.is_now_ready(work_of(calibration))


def _usual(kind: str) -> Calibration:
    """A head of one camera that can be drawn, with a slide of rings or one bright ring."""
    camera = Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)
    rings = tuple(Cone(math.radians(full / 2), (0.0, 0.0, 1.0), (0.0, 0.0, -56.0)) for full in (38, 42, 47, 53, 58))
    if kind == "line":
        return Calibration(camera, "", rings[2:3], 76.2, pattern={"kind": kind})
    return Calibration(camera, "RRGBGR", rings, 76.2)


def _compile(calibration: Calibration) -> None:
    profiles = _drawn_scan(calibration)
    if not any(len(profile.points_mm) for profile in profiles):  # two cameras know a drawn wall too badly to keep it
        profiles = _drawn_scan(replace(calibration, others=()))
    lit = [
        LedFrame(index, STEP_MM * index, np.full((one.camera.height, one.camera.width, 3), GREY, np.uint8), one.id)
        for index in (FRAMES // 4, FRAMES // 2)
        for one in calibration.cameras
    ]
    survey(profiles, calibration, iter(lit))


def _drawn_scan(calibration: Calibration) -> list[Profile]:
    method = method_for(calibration)
    seed: Pose | None = None
    profiles: list[Profile] = []
    frames = {one.id: warmup_frame(calibration, one) for one in calibration.cameras}
    for index in range(FRAMES):
        profile = method(ScanFrame(index, Label.PROJECTOR, STEP_MM * index, "drawn"), frames, seed)
        profiles.append(profile)
        seed = profile.pose
    return profiles


def _in_a_child(calibration: Calibration, out: Connection, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: never outlive the command
    if os.getppid() != parent:
        os._exit(1)
    with telling(out.send), contextlib.suppress(Exception):  # what is wrong, the scan itself will say
        compile_all(calibration)


def _beside() -> None:
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    if os.getppid() == int(sys.argv[1]):
        compile_all(Calibration.from_dict(json.load(sys.stdin)))
