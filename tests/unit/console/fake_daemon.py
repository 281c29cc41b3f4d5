"""A daemon that says what the contract says and does nothing: for pages, tests and benchmarks of the console.

    python tests/unit/console/fake_daemon.py --fps 25      # prints PUBLISH,CONTROL; Ctrl-C ends it

A round pipe of 150 mm with a dent, a head that goes on at 3 mm a frame; frames in a lamp cycle of four to one.
"""

import argparse
import math
import sys
import threading
import time
from collections import Counter, deque
from functools import cache
from typing import Any, Self

import cv2
import msgpack
import numpy as np
import zmq
from numpy.typing import NDArray

RADIUS_MM = 75.0
MM_PER_FRAME = 3.0
RINGS, DIRECTIONS = 10, 300  # 3000 points a frame
WIDTH, HEIGHT = 832, 616  # of the half-size picture
RATIO = 4
HOLD_S = 30.0
COMMAND_S = 10.0
TOKENS = ("preview/0", "rows/0", "slits/0")


@cache
def jpeg(number: int, lamp: str, quality: int = 80, size: int = 38_000) -> bytes:
    """(H, W) picture of rings or of the lit wall, about `size` bytes."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    r = np.hypot(x - WIDTH / 2, y - HEIGHT / 2)
    if lamp == "projector":
        picture = 12 + 190 * np.exp(-(((r + number) % 60 - 30) ** 2) / 30)
    elif lamp == "led":
        picture = 150 * np.exp(-((r / 260) ** 2)) + 25 * np.sin(x / 19 + number / 5) + 40
    else:
        picture = np.full_like(r, 6.0)
    picture[:24, : 8 + (number * 7) % (WIDTH - 8)] = 255
    rng = np.random.default_rng(number)
    bgr = np.stack([picture, 0.95 * picture, 0.9 * picture], axis=-1)
    noise = rng.normal(0, 1, (HEIGHT, WIDTH, 1))
    for sigma in (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0):
        drawn = np.clip(bgr + sigma * noise, 0, 255).astype(np.uint8)
        data = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(data) >= size:
            break
    return data


def profile(index: int, z_mm: float) -> dict[str, Any]:
    """What Profile.to_dict says of 3000 points of a dented pipe."""
    phi = np.tile(np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS, RINGS)
    z = z_mm + np.repeat(30.0 + 25.0 * np.arange(RINGS), DIRECTIONS)
    radius = radius_at(z, phi) + np.random.default_rng(index).normal(0, 0.05, len(z))
    points = np.stack([radius * np.sin(phi), -radius * np.cos(phi), z], axis=1).astype("<f4")
    count = len(points)
    return {
        "frame": index,
        "camera": 0,
        "z_mm": z_mm,
        "pose": [0.0, 0.0, 0.0, 0.0],
        "points": points.tobytes(),
        "colour": np.full((count, 3), 180, np.uint8).tobytes(),
        "ring": np.repeat(np.arange(RINGS, dtype=np.uint8), DIRECTIONS).tobytes(),
        "direction": np.tile(np.arange(DIRECTIONS, dtype="<u2"), RINGS).tobytes(),
        "sigma": np.full(count, 0.05, "<f4").tobytes(),
        "ring_sigma": b"",
        "residual_mm": 0.05,
        "lean_sigma_deg": 0.1,
        "rejected": {},
        "timing_ms": {"total": 9.0},
    }


def radius_at(z_mm: NDArray[np.float64], phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Every 500 mm a dent of 2 mm at 3 o'clock, and 1 mm of wall lost at 9."""
    along = ((z_mm % 500.0) - 250.0) / 25.0
    dent = 2.0 * np.exp(-(along**2) - (np.angle(np.exp(1j * (phi - np.pi / 2))) / 0.2) ** 2)
    loss = 1.0 * np.exp(-(along**2) - (np.angle(np.exp(1j * (phi - 3 * np.pi / 2))) / 0.2) ** 2)
    return np.asarray(RADIUS_MM - dent + loss)


def wall_rows(first: int, rows: int, step_mm: float) -> bytes:
    """int16 (rows, 360), deviation of the radius in 0.01 mm."""
    z = (first + np.arange(rows) + 0.5) * step_mm
    phi = np.radians(np.arange(360) + 0.5)
    deviation = 100 * (radius_at(z[:, None] * np.ones(360), phi[None] * np.ones((rows, 1))) - RADIUS_MM)
    return np.asarray(np.rint(deviation)).astype("<i2").tobytes()


class FakeDaemon:
    """Binds, publishes and answers in a thread of its own; `with FakeDaemon(fps=25) as head:`.

    scanning : whether a scan is under way at once. Without it `start` begins one, as with the real one.
    `asked` are the requests it had, newest last; `answers` replaces what it says to a request, by its `do`.
    """

    def __init__(
        self, fps: float = 25.0, scanning: bool = False, scan: int = 7, address: str = "tcp://127.0.0.1"
    ) -> None:
        self.fps, self.scan = fps, scan
        self.asked: deque[dict[str, Any]] = deque(maxlen=200)
        self.answers: dict[str, dict[str, Any]] = {}
        self.numbers: Counter[str] = Counter()
        self.subscribed: set[bytes] = set()
        self.index, self.z_mm = 0, 0.0
        self.state = "scanning" if scanning else "idle"
        self.trial_until: float | None = None
        self.command: tuple[str, str, float, float] | None = None  # id, name, since, until
        self.job: dict[str, Any] = {}
        self.lamps = {
            "ratio": RATIO,
            "projector_delay_us": 3000.0,
            "projector_width_us": 5000.0,
            "led_delay_us": 3000.0,
            "led_width_us": 2500.0,
        }
        self.silent = False  # says and answers nothing, as one that hangs
        self.extra: deque[tuple[str, Any, bytes]] = deque()  # to be published next
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._publish = self._context.socket(zmq.XPUB)
        self._publish.setsockopt(zmq.SNDHWM, 1000)
        self._control = self._context.socket(zmq.ROUTER)
        for socket in (self._publish, self._control):
            socket.setsockopt(zmq.LINGER, 0)
        whole = address.count(",") == 1
        for socket, where in zip(
            (self._publish, self._control), address.split(",") if whole else [f"{address}:*"] * 2, strict=True
        ):
            socket.bind(where)
        self.publish, self.control = (
            socket.getsockopt_string(zmq.LAST_ENDPOINT) for socket in (self._publish, self._control)
        )
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._jpegs = {lamp: [jpeg(n, lamp) for n in range(4)] for lamp in ("projector", "led")}

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def say(self, topic: str, body: Any, part: bytes = b"") -> None:
        number = self.numbers[topic]
        self.numbers[topic] += 1
        if not self.silent:
            self._publish.send_multipart([topic.encode(), msgpack.packb({"n": number, "body": body}), part])

    def wanted(self, topic: str) -> bool:
        return any(topic.encode().startswith(one) for one in self.subscribed)

    def _run(self) -> None:
        next_frame = next_second = next_wall = time.monotonic()
        while not self._ended.is_set():
            now = time.monotonic()
            self._listen()
            self._answer()
            while self.extra:
                self.say(*self.extra.popleft())
            if self.trial_until is not None and now > self.trial_until:
                self.trial_until = None
                self._become("idle", "trial ended: nobody held it")
            if now >= next_second:
                self._second(now)
                next_second += 1.0
            if now >= next_frame:
                if self.state == "scanning":
                    self._frame()
                next_frame = max(next_frame + 1 / self.fps, now - 0.2)
            if now >= next_wall:
                if self.state == "scanning":
                    self._wall()
                next_wall += 0.5
            wait = min(next_frame, next_second, next_wall) - time.monotonic()
            self._control.poll(max(0, min(20, int(1000 * wait))))

    def _listen(self) -> None:
        while self._publish.poll(0):
            said = self._publish.recv()
            (self.subscribed.add if said[:1] == b"\1" else self.subscribed.discard)(said[1:])

    def _become(self, state: str, why: str = "") -> None:
        self.state = state
        self.say("state", {"state": state, "why": why})

    def _second(self, now: float) -> None:
        if self.command is not None and now > self.command[3]:
            self.command = None
        if self.index == 0:
            self.say("state", {"state": self.state, "why": ""})
        by = self.command
        self.say("health", {"health": "ok", "why": ""})
        self.say(
            "telemetry",
            {
                "state": self.state,
                "seconds": self.index / self.fps,
                "scan": self.scan,
                "profiles": self.index * 4 // 5,
                "frames": {"projector": self.index * 4 // 5, "led": self.index // 5, "unknown": 3},
                "unknown": {"edges were lost": 2, "picture unclear": 1},
                "drops": {"worker_busy": 2},
                "disk": {"free_gb": 120.0, "mb_per_s": 22.0, "minutes_left": 91.0},
                "command": None if by is None else {"name": by[1], "since_s": now - by[2]},
                "trial": None if self.trial_until is None else max(0.0, self.trial_until - now),
                "paused": self.state == "paused",
                "lamps": self.lamps,
                "job": self.job,
                "interlock": "closed",
                "recording": "/scans/20261125.mcap" if self.state in ("scanning", "paused") else "",
                "turn_ms": 3.0,
            },
        )
        self.say(
            "sensor/odometer",
            {
                "sensor": "odometer",
                "host_ns": time.monotonic_ns(),
                "values": [self.z_mm * 20, self.z_mm],
                "units": ["counts", "mm"],
            },
        )
        self.say(
            "sensor/supply",
            {
                "sensor": "supply",
                "host_ns": time.monotonic_ns(),
                "values": {"volts": 5.02, "amperes": 1.2, "celsius": 41.0},
                "units": {"volts": "V", "amperes": "A", "celsius": "degC"},
            },
        )

    def _header(self) -> dict[str, Any]:
        slot = self.index % (RATIO + 1)
        return {
            "index": self.index,
            "sequence": self.index,
            "timestamp_ns": time.monotonic_ns(),
            "camera": 0,
            "label": "led" if slot == RATIO else "projector",
            "reason": "",
            "edge": self.index,
            "slot": slot,
            "odometer": int(self.z_mm * 20),
            "z_mm": self.z_mm,
            "roll_deg": 0.5,
            "encoding": "bayer_rggb8",
            "width": 2 * WIDTH,
            "height": 2 * HEIGHT,
            "arrived_ns": time.monotonic_ns(),
            "z_assumed": False,
            "z_bound_mm": 0.0,
            "segment": 0,
        }

    def _frame(self) -> None:
        header = self._header()
        lamp = header["label"]
        self.say("label", header)
        if self.wanted("preview/0"):
            body = {**header, "preview": {"width": WIDTH, "height": HEIGHT}, "published": time.time()}
            self.say("preview/0", body, self._jpegs[lamp][self.index % 4])
        if self.wanted("rows/0"):
            rows = (120 + 20 * np.sin(np.arange(64) / 5 + self.index / 9)).astype("<f4")
            body = {"index": self.index, "label": lamp, "camera": 0, "edge": self.index, "slot": header["slot"]}
            self.say("rows/0", body, rows.tobytes())
        if lamp == "projector":
            self.say("profile", profile(self.index, self.z_mm))
            if self.wanted("slits/0"):
                self.say("slits/0", {"index": self.index, "camera": 0}, _slits())
        self.index += 1
        self.z_mm += MM_PER_FRAME
        if self.index % 50 == 0:
            self._defects()

    def _wall(self) -> None:
        for of, step, most in (("recent", 5.0, 2000), ("whole", 10.0, 2048)):
            last = int((self.z_mm + 280) / step)
            first = max(0, last - 60, last - most)
            for begin, rows in ((first, last - first), (0, min(40, last))):
                if rows > 0:
                    body = {
                        "scan": self.scan,
                        "of": of,
                        "step_mm": step,
                        "first": begin,
                        "rows": rows,
                        "columns": 360,
                        "radius_mm": RADIUS_MM,
                    }
                    self.say("wall", body, wall_rows(begin, rows, step))

    def _defects(self) -> None:
        dents = [250.0 + 500.0 * k for k in range(int(self.z_mm // 500))][-500:]
        found = [
            {
                "id": k,
                "kind": "dent",
                "z_mm": z,
                "clock_deg": 90.0,
                "clock": "3:00",
                "depth_mm": 2.0,
                "depth_k2_mm": 0.2,
                "floor_seen": True,
                "length_mm": 48.0,
                "arc_deg": 24.0,
                "frames": list(range(max(0, self.index - 12), self.index)),
            }
            for k, z in enumerate(dents)
        ]
        looked = [max(0.0, self.z_mm - 1500), self.z_mm]
        self.say(
            "defects",
            {"scan": self.scan, "looked_mm": looked, "defects": found, "diameter_mm": 2 * RADIUS_MM, "k2_mm": 0.1},
        )
        for one in found[-1:]:
            section = radius_at(np.full(360, one["z_mm"]), np.radians(np.arange(360) + 0.5)).astype("<f4")
            along = radius_at(one["z_mm"] + np.arange(-60.0, 60.0, 2.0), np.full(60, np.pi / 2)).astype("<f4")
            body = {
                "scan": self.scan,
                "id": one["id"],
                "section_mm": section.tobytes(),
                "along_mm": along.tobytes(),
                "along_from_mm": one["z_mm"] - 60.0,
                "along_step_mm": 2.0,
                "nominal_mm": RADIUS_MM,
            }
            picture = np.full((120, 240, 3), 128, np.uint8)
            cv2.circle(picture, (120, 60), 30, (40, 40, 200), -1)
            self.say("closeup", body, cv2.imencode(".png", picture)[1].tobytes())

    def _answer(self) -> None:
        while self._control.poll(0):
            parts = self._control.recv_multipart()
            asked = msgpack.unpackb(parts[-1])
            self.asked.append(asked)
            if self.silent:
                continue
            error, more = "", {}
            try:
                more = self.answers[asked["do"]] if asked["do"] in self.answers else self._do(asked)
            except ValueError as refused:
                error = str(refused)
            answer = {"ok": not error, "state": self.state, "health": "ok", "error": error, **more}
            self._control.send_multipart([*parts[:-1], msgpack.packb(answer)])

    def _do(self, asked: dict[str, Any]) -> dict[str, Any]:
        now, who = time.monotonic(), asked.get("who") or {}
        do = asked["do"]
        if self.command is not None and now > self.command[3]:
            self.command = None
        if "who" in asked and not (who.get("id") and who.get("name")):
            raise ValueError("who: expected an id and a name that are not empty")
        other = self.command is not None and self.command[0] != who.get("id")
        if other and do in ("start", "resume", "zero", "job", "lamps", "hold"):
            assert self.command is not None
            raise ValueError(f"{self.command[1]} commands")
        if do == "command":
            if other and not asked.get("take"):
                assert self.command is not None
                raise ValueError(f"{self.command[1]} commands")
            since = self.command[2] if self.command is not None and not other else now
            self.command = (who.get("id", ""), who.get("name", ""), since, now + COMMAND_S)
        elif do == "release":
            self.command = None if not other else self.command
        elif do == "start":
            if self.state != "idle":
                raise ValueError(f"start is not possible while the head is {self.state}, only while it is idle")
            self.index, self.z_mm, self.scan = 0, 0.0, self.scan + 1
            if asked.get("record") is False:
                self.trial_until = now + min(HOLD_S, asked.get("hold_s", HOLD_S))
            self.say("begun", {"scan": self.scan})
            self._become("armed")
            self._become("scanning")
            return {"scan": self.scan}
        elif do == "hold":
            if self.trial_until is None:
                raise ValueError("no trial is under way")
            self.trial_until = now + 10.0
        elif do in ("stop", "pause", "resume"):
            allowed = {"stop": ("scanning", "paused"), "pause": ("scanning",), "resume": ("paused",)}[do]
            if self.state not in allowed:
                raise ValueError(f"{do} is not possible while the head is {self.state}")
            self.trial_until = None
            self._become({"stop": "idle", "pause": "paused", "resume": "scanning"}[do])
            if do == "stop":
                self.say("ended", {"seconds": self.index / self.fps, "recordings": ["/scans/20261125.mcap"]})
        elif do == "mark":
            self.say(
                "mark",
                {
                    "host_ns": time.monotonic_ns(),
                    "z_mm": self.z_mm,
                    "text": asked.get("text", ""),
                    "clock_deg": asked.get("clock_deg"),
                    "frame": self.index,
                    "camera": 0,
                },
            )
        elif do == "zero":
            self.z_mm = 0.0
            self.say("event", {"kind": "odometer", "text": "z is 0 from here on"})
        elif do == "job":
            self.job.update(asked.get("job", {}))
        elif do == "lamps":
            lamps = {**self.lamps, **asked.get("lamps", {})}
            end = max(lamps[f"{one}_delay_us"] + lamps[f"{one}_width_us"] for one in ("projector", "led"))
            if end > 12000:
                raise ValueError(f"flash ends at {end:g} us, after the window 2000..12000 us in which all rows expose")
            if asked.get("commit"):
                self.lamps = lamps
            return {"lamps": lamps}
        elif do == "about":
            return {"about": self._about()}
        elif do != "state":
            raise ValueError(f"do is {do!r}, expected one of start, stop, mark, zero, state")
        return {}

    def _about(self) -> dict[str, Any]:
        return {
            "cameras": [
                {
                    "number": 0,
                    "kind": "remote",
                    "device": "ipc:///head",
                    "width": 2 * WIDTH,
                    "height": 2 * HEIGHT,
                    "fps": self.fps,
                    "exposure_us": 38000.0,
                    "readout_us": 28000.0,
                    "gain": 1.0,
                }
            ],
            "window": {"opens_us": 2000.0, "closes_us": 12000.0},
            "lamps": self.lamps,
            "job": self.job,
            "calibration": {
                "file": "head-7.json",
                "provenance": {"camera": {"made": "2026-11-01"}},
                "age_days": 24.0,
                "nominal_diameter_mm": 2 * RADIUS_MM,
            },
            "controller": {"commit": "abcdef1", "version": "0.1.0"},
            "record": {"folder": "/scans", "codec": "zstd"},
            "limits": {"width_us": 20000.0, "duty": 0.5},
            "version": "0.1.0",
        }


def _slits() -> bytes:
    phi = np.tile(np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS, RINGS)
    r = np.repeat(60.0 + 22.0 * np.arange(RINGS), DIRECTIONS)
    xy = np.stack([WIDTH / 2 + r * np.sin(phi), HEIGHT / 2 - r * np.cos(phi)], axis=1)
    ring = np.repeat(np.arange(RINGS, dtype=np.uint8), DIRECTIONS)
    return np.rint(8 * xy).astype("<i2").tobytes() + ring.tobytes()


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--fps", type=float, default=25.0)
    arguments.add_argument("--idle", action="store_true", help="no scan is under way until somebody starts one")
    arguments.add_argument("--seconds", type=float, default=math.inf)
    arguments.add_argument("--address", default="tcp://127.0.0.1", help="or PUBLISH,CONTROL")
    given = arguments.parse_args()
    with FakeDaemon(given.fps, scanning=not given.idle, address=given.address) as head:
        print(f"{head.publish},{head.control}", flush=True)
        end = time.monotonic() + given.seconds
        try:
            while time.monotonic() < end:
                time.sleep(0.2)
        except KeyboardInterrupt:
            sys.exit(0)


if __name__ == "__main__":
    main()
