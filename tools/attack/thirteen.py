"""`python -m tools.attack.thirteen [--before REVISION] [ROW ..]`: thirteen attacks that once worked, before and after.

Each is measured on the image of an earlier revision, built in a worktree, and on the image of this tree, or with both
hosts. Ends with status 1 when a number of this tree breaks its promise.
"""

import argparse
import atexit
import functools
import importlib
import itertools
import os
import pty
import subprocess
import sys
import tempfile
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from annulus_pipe.controller import PIN_INTERLOCK, PIN_LED, PIN_MICROWAVE, PIN_STEP, PIN_SYNC
from annulus_pipe.link.messages import (
    LEVEL,
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstStop,
    Clear,
    Commit,
    Edge,
    Identify,
    Info,
    Move,
    Ping,
    Reread,
    RereadReply,
    Stage,
    Status,
    StatusCode,
    StatusReply,
    SyncLost,
)
from annulus_pipe.vocabulary import EdgeFlag
from tools.attack.boards import BOOTED, MS, ROOT, USB, BrokenPromiseError, Emulated
from tools.attack.kept import Kept
from tools.attack.odometer import is_odometer
from tools.attack.play import Player
from tools.attack.scenes import QUADRATURE

US = MS // 1000
NOTHING = ArmFlag(0)
WATCHDOG = 100 * MS


@dataclass(frozen=True, slots=True)
class Place:
    """One of the two revisions."""

    image: Path
    host: Path


Measured = tuple[str, bool]  # the number with its unit, and whether the promise holds


def started(place: Place, outputs: ArmFlag = NOTHING, config: Stage | None = None) -> Player:
    player = Player(Emulated(place.image))
    player.board.input([(player.board.now, PIN_INTERLOCK, 0)])
    player.request(Identify(protocol=1, schema=SCHEMA_HASH))
    if config:
        player.request(config)
        player.request(Commit(generation=config.generation))
    if outputs:
        player.request(Arm(outputs=outputs))
    return player


def alive(player: Player, until: int) -> None:
    """Run, with a ping now and then."""
    while player.board.now < until:
        player.send(player.line, Ping())
        player.run(min(until, player.board.now + 20 * MS))


def pulses(player: Player, pin: int) -> list[tuple[int, int]]:
    """Those that have ended, and one that has not, until now."""
    still = [(player.high[pin], player.board.now)] if pin in player.high else []
    return [*player.kept.pulses.get(pin, []), *still]


def lit(player: Player, pin: int) -> int:
    return sum(fall - rise for rise, fall in pulses(player, pin))


def config_of(period: int, delay: int, width: int, tolerance: int = 100, ratio: int = 0) -> Stage:
    return Stage(1, ratio, period, period, 0, tolerance, 5000, delay, width, delay, width)


def steady(player: Player, begin: int, period: int, count: int) -> list[int]:
    falls = [begin + i * period for i in range(count)]
    player.board.input([edge for fall in falls for edge in ((fall, PIN_SYNC, 0), (fall + 10 * US, PIN_SYNC, 1))])
    return falls


# ---- the attacks ----


def bursts_one_by_one(place: Place) -> Measured:
    player = started(place, ArmFlag.MICROWAVE)
    burst = Burst(code=BurstCode.SINGLE, chip=3000, repeat=1, period=60_000, trigger_offset=0)
    begin = player.board.now
    while player.board.now < begin + 60 * MS:
        asked = [player.send(player.line, burst) for _ in range(6)]
        player.run(asked[-1].through + 200 * US)
        if any(a.reply and a.reply.status == StatusCode.UNSAFE for a in asked):  # as a host that does not want to see
            player.request(Clear())
            player.request(Arm(outputs=ArmFlag.MICROWAVE))
    player.run(player.board.now + 2 * MS)
    seen = pulses(player, PIN_MICROWAVE)
    share = 100 * sum(fall - rise for rise, fall in seen[:-1]) / (seen[-1][0] - seen[0][0]) if len(seen) > 1 else 0.0
    return f"{share:.1f} % on", share <= 5.0


def lamp_at_early_edges(place: Place) -> Measured:
    config = config_of(40 * MS, 0, 1_999_000, tolerance=500)
    player = started(place, config=config)
    if player.request(Arm(outputs=ArmFlag.LAMPS)).status != StatusCode.OK:  # type: ignore[union-attr]
        for command in (config_of(40 * MS, 0, 1_000_000, 500), Commit(generation=1), Arm(outputs=ArmFlag.LAMPS)):
            player.request(command)
    falls = steady(player, player.board.now + MS, 20 * MS + 100, 25)
    alive(player, falls[-1])
    share = 100 * lit(player, PIN_LED) / (falls[-1] - falls[0])
    return f"{share:.1f} % on", share <= 50.1


def jerk_of_the_cable(place: Place) -> Measured:
    player = started(place)
    at, count = player.board.now + MS, 0
    for way in [1] * 300 + [-1] * 300:
        count += way
        before, after = QUADRATURE[(count - way) % 4], QUADRATURE[count % 4]
        pin = 14 if before[0] != after[0] else 15
        player.board.input([(at, pin, after[pin - 14])])
        at += 10 * US
    player.run(at + 5 * MS)
    status = player.request(Status())
    assert isinstance(status, StatusReply)
    said = any(is_odometer(told.event) for told in player.kept.told.values())
    return f"{status.odometer} counts off{' and said so' if said else ''}", status.odometer == 0 or said


def stop_of_a_slow_train(place: Place) -> Measured:
    player = started(place, ArmFlag.MICROWAVE)
    player.request(Burst(code=1, chip=50, repeat=9, period=500 * MS, trigger_offset=500 * MS - 100))  # type: ignore[arg-type]
    player.board.longest = 0
    asked = player.send(player.line, BurstStop())
    while asked.reply is None and player.board.now < asked.sent + 3 * WATCHDOG and not player.kept.boots:
        player.run(player.board.now + MS // 10)
    if player.kept.boots:
        return "main loop held for 100 ms, then reset", False
    return f"main loop held for {player.board.longest / US:.0f} us", player.board.longest <= player.board.round_max


def spurious_losses(place: Place) -> Measured:
    player = started(place, config=config_of(2 * MS, 0, 0))
    falls = steady(player, player.board.now + MS, 2 * MS + 37, 600)
    alive(player, falls[-1] + MS)
    lost = sum(isinstance(item.event, SyncLost) for item in player.kept.told.values())
    return f"{lost} sync_lost in 600 edges", lost == 0


def after_a_pause(place: Place) -> Measured:
    player = started(place, ArmFlag.LAMPS, config_of(10 * MS, 0, 2 * MS))
    falls = steady(player, player.board.now + MS, 10 * MS, 3)
    alive(player, falls[-1] + 30_000 * MS)
    player.kept = Kept()
    tick = player.board.now + MS
    steady(player, tick, 10 * MS, 1)
    alive(player, tick + 20 * MS)
    late = any(isinstance(i.event, Edge) and i.event.flags & EdgeFlag.LATE_LOAD for i in player.kept.told.values())
    width = lit(player, PIN_LED)
    return f"lit {width / US:.0f} of 2000 us{', told as dark' if late else ''}", width == 2 * MS and not late


def edge_while_withdrawn(place: Place) -> Measured:
    return by_tests(place, "tests/emulator/test_image_lamps.py", "taken_back")


def runaway_stage(place: Place) -> Measured:
    player = started(place, ArmFlag.MICROWAVE)
    player.request(Move(position=100_000_000, period=10_000, hold=0))
    alive(player, player.board.now + 50 * MS)
    opened = player.board.now + 1
    player.board.input([(opened, PIN_INTERLOCK, 1)])
    alive(player, opened + 1000 * MS)
    ran = pulses(player, PIN_STEP)
    after = ran[-1][0] - opened if ran else 0
    if not ran:
        return "refused", True
    return (
        "still running 1 s after the interlock opened"
        if after > 990 * MS
        else f"stands {max(0, after) / MS:.1f} ms after the interlock opened"
    ), after < 500 * MS


def two_rereads(place: Place) -> Measured:
    player = started(place)
    falls = steady(player, player.board.now + MS, 2 * MS, 40)
    alive(player, falls[-1] + 5 * MS)
    player.kept = Kept()
    asked = [player.send(player.line, Reread(first=1, count=25)), player.send(player.line, Reread(first=28, count=7))]
    player.run(player.board.now + 60 * MS)
    promised = sum(a.reply.count for a in asked if isinstance(a.reply, RereadReply))
    came = sum(map(len, player.kept.times_told.values()))
    return f"{came} came of {promised} promised", came == promised


def late_in_a_frame(place: Place) -> Measured:
    player = started(place)
    player.board.plug(True)
    while not player.board.connected() and player.board.now < 600 * MS:
        player.run(player.board.now + 5 * MS)
    player.line = USB
    player.request(Identify(protocol=1, schema=SCHEMA_HASH))
    try:
        for i in range(300):
            player.send(USB, Ping())
            player.run(player.board.now + 2 * MS + 37 * US * (i % 27))
    except BrokenPromiseError as error:
        ticks = int(str(error).split("handed over ")[1].split()[0]) if "handed over" in str(error) else -1
        return f"bulk IN handed over {ticks / US:.0f} us into a frame", False
    answered = sum(a.reply is not None for a in player.kept.asked)
    return f"none late in a frame in {answered} answers", answered > 290


POWER_UPS = 40


def alike_after_power_ups(place: Place) -> Measured:
    """With a ring oscillator that is not fair: three ones in four, and the same bit again within 0.5 us."""
    player = started(place)
    assert isinstance(player.board, Emulated)
    boots: list[tuple[int, int]] = []
    for _ in range(POWER_UPS):
        boot = getattr(player.request(Identify(protocol=1, schema=SCHEMA_HASH)), "boot", -1)
        info = player.request(Info(level=LEVEL))
        boots.append((boot, getattr(info, "nonce", 0)))
        player.board.power_cycle()
        player.run(player.board.now + BOOTED)
        player.board.input([(player.board.now, PIN_INTERLOCK, 0)])
    alike = sum(a == b for a, b in itertools.pairwise(boots))
    return f"{alike} of {len(boots) - 1} power-ups looked like the boot before", alike == 0


MARK = b"between-two-openings"
OPENING = f"""
import sys
from annulus_pipe.link.messages import Ping
from annulus_pipe.link.session import Session
try:
    from annulus_pipe.link.port import Port
except ImportError:  # where it was before
    from annulus_pipe.link.client import Port
session = Session()
for number in (1, 2):
    port = Port(sys.argv[1])
    session.send(Ping())
    port.write(session.pending(number * 10**9))
    port.write({MARK!r})
    port.close()
"""


def opened_again(place: Place) -> Measured:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    run = [sys.executable, "-c", OPENING, name]
    subprocess.run(run, check=True, env=os.environ | {"PYTHONPATH": str(place.host)})
    said = os.read(ours, 4096)
    os.close(ours)
    os.close(theirs)
    again = said.split(MARK)[1][:1]
    return f"begins with 0x{again.hex()}", again == bytes(1)


def by_tests(place: Place, path: str, keyword: str) -> Measured:
    """What cannot be met at a time chosen from outside: the tests that can stop a processor, or run a kernel."""
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "--no-header", path, "-k", keyword],
        cwd=ROOT,
        env=os.environ | {"ANNULUS_IMAGE": str(place.image)},
        capture_output=True,
        text=True,
    )
    lines = [line for line in run.stdout.splitlines() if line.startswith("E  ")] or run.stdout.splitlines() or ["?"]
    said = " ".join(lines[0].strip("E =").split()).replace("|", "/")
    return ("test passed" if run.returncode == 0 else f"test failed: {said[:90]}"), run.returncode == 0


FRAMES = """
import sys
sys.path.insert(0, sys.argv[1])
try:
    from annulus_pipe.capture.v4l2 import V4L2Camera
except ImportError:
    from annulus_pipe.capture.camera import V4L2Camera
from annulus_pipe.capture.camera import grab
from annulus_pipe.vocabulary import AnnulusError
try:
    camera = V4L2Camera("/dev/video0", width=640, height=360)
    camera.start()
    stamps = [grab(camera).timestamp_ns for _ in range(20)]
    camera.stop()
    print(f"20 frames in {(stamps[-1] - stamps[0]) / 1e9:.2f} s")
except AnnulusError as error:
    print(f"no frame: {error}")
"""


@functools.cache
def guest() -> Any:
    """A machine with Debian's own kernel and its camera driver for tests; one boot for both hosts."""
    sys.path.insert(0, str(ROOT / "tests/guest"))
    machine = importlib.import_module("machine").Guest()
    atexit.register(machine.close)
    machine.modprobe("vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x0")
    return machine


def frames_of_a_kernel(place: Place) -> Measured:
    done = guest().python(FRAMES, str(place.host), seconds=200.0)
    said = " ".join((done.stdout or done.stderr.strip().splitlines()[-1]).split())
    return said[:120], said.startswith("20 frames")


ROWS: tuple[tuple[str, str, Callable[[Place], Measured]], ...] = (
    ("1", "microwave, bursts of 30 us sent one after the other, limit 5 %", bursts_one_by_one),
    ("2", "lamp, sync at twice the configured rate, limit 50 %", lamp_at_early_edges),
    ("3", "odometer, 300 counts up and 300 down with the camera off", jerk_of_the_cable),
    ("4", "burst_stop, period 500 ms, trigger 499.999 ms", stop_of_a_slow_train),
    ("5", "sync that is never lost", spurious_losses),
    ("6", "first flash after a pause of 30 s", after_a_pause),
    ("7", "edge within the twelve cycles in which a flash is taken back", edge_while_withdrawn),
    ("8", "stage on its way for 3 hours, interlock opens", runaway_stage),
    ("9", "two rereads at once", two_rereads),
    ("10", "RP2040-E15 over USB", late_in_a_frame),
    ("11", "V4L2 camera at the kernel's own test driver", frames_of_a_kernel),
    ("12", "power-ups told apart, ring oscillator not fair", alike_after_power_ups),
    ("13", "a port opened again begins with a delimiter", opened_again),
)


def build(revision: str, scratch: Path) -> Place:
    """A worktree of the revision and its image."""
    tree = scratch / "before"
    subprocess.run(["git", "worktree", "add", "--quiet", "--detach", str(tree), revision], cwd=ROOT, check=True)
    subprocess.run(["make", "--silent", "-C", str(tree / "firmware"), "image"], check=True, stdout=subprocess.DEVNULL)
    return Place(tree / "firmware/build/annulus.uf2", tree / "host")


def measure(attack: Callable[[Place], Measured], place: Place) -> Measured:
    try:
        return attack(place)
    except BrokenPromiseError as error:
        return " ".join(str(error).split()), False


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.attack.thirteen")
    parser.add_argument("--before", default="1a8be7d", metavar="REVISION")
    parser.add_argument("rows", nargs="*", metavar="ROW")
    given = parser.parse_args(arguments)
    subprocess.run(["make", "--silent", "-C", str(ROOT / "firmware"), "image"], check=True, stdout=subprocess.DEVNULL)
    now, missed = Place(ROOT / "firmware/build/annulus.uf2", ROOT / "host"), 0
    (ROOT / "build").mkdir(exist_ok=True)  # not in /tmp, which a guest has for itself
    with tempfile.TemporaryDirectory(dir=ROOT / "build") as scratch:
        before = build(given.before, Path(scratch))
        try:
            print(f"| | attack | before ({given.before}) | after | |\n|---|---|---|---|---|")
            for number, what, attack in ROWS:
                if given.rows and number not in given.rows:
                    continue
                (was, _), (is_now, kept) = measure(attack, before), measure(attack, now)
                missed += not kept
                print(f"| {number} | {what} | {was} | {is_now} | {'kept' if kept else '**broken**'} |", flush=True)
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(before.image.parents[2])], cwd=ROOT, check=True)
    print(f"{missed} promises broken" if missed else "every promise kept")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
