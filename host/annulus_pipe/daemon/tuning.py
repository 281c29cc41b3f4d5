"""A lamp of a running head stepped over its exposure window, in a trial: what `annulus tune` and the console do.

    found = tune(client, "tcp://127.0.0.1:5601", "projector", progress=lambda what, done, total: ...)

Frames of an old setting are not counted: they lie before the edge that was the newest when the controller confirmed the
new one. Whatever happens, the trial is ended, and with it the former lamps are back; when this process is killed the
daemon does both HOLD_S later.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import zmq

from annulus_pipe import untrusted
from annulus_pipe.capture.plateau import Proposal, Reading, confirmed, find
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.stream.access import ClientKeys, connected
from annulus_pipe.stream.publish import parse
from annulus_pipe.vocabulary import AnnulusError, Label

LAMPS = {"projector": Label.PROJECTOR, "led": Label.LED}
STEPS = 14
FRAMES = 3  # of each setting; their median is the reading
BEYOND = 0.35  # of the readout, past both ends of the window that head.toml predicts
HOLD_S, RENEW_S = 5.0, 1.5
UP_S = 30.0  # until the first frames of the lamp
PATIENCE_PERIODS = 60  # for the frames of one setting, and ..
PATIENCE_S = 2.0
WRONG_US = 100.0  # by which head.toml may differ before somebody is told
SKIPPED = 2  # edges after the newest one known, whose frames are on their way
QUEUE = 1000
MESSAGE_MAX = 1 << 20

Progress = Callable[[str, int, int], None]


class Cancelled(AnnulusError):
    """Somebody did not want it any more."""


@dataclass(frozen=True, slots=True)
class Tuned:
    """What was found of one lamp."""

    lamp: str
    proposal: Proposal
    readings: tuple[Reading, ...] = field(repr=False)
    seconds: float

    @property
    def proposed(self) -> dict[str, float]:
        """Keys and values of [lamps]."""
        return {f"{self.lamp}_delay_us": self.proposal.delay_us, f"{self.lamp}_width_us": self.proposal.width_us}

    @property
    def remarks(self) -> list[str]:
        """For people: what was found, a line each."""
        one = self.proposal
        edges = (
            f"{word} {at:.0f}" + (f" +- {k2:.0f} us" if k2 is not None else " or beyond: this edge was not seen")
            for word, at, k2 in (("opens", one.opens_us, one.opens_k2_us), ("closes", one.closes_us, one.closes_k2_us))
        )
        lines = [f"{self.lamp}: {one.why}", "; ".join(edges) + f"; the widest flash is {one.widest_us:.0f} us"]
        for key, k2, more in (
            ("exposure_us", one.opens_k2_us, one.predicted_us[0] - one.opens_us),
            ("readout_us", one.closes_k2_us, one.predicted_us[1] - one.closes_us),
        ):
            if k2 is not None and abs(more) > max(k2, WRONG_US):
                lines.append(f"head.toml: {key} is {abs(more):.0f} us too {'small' if more > 0.0 else 'large'}")
        if one.banding is not None and one.light is not None and one.saturated is not None:
            lines.append(
                f"tried: bands of {100 * one.banding:.1f} %, light {one.light:.1f} of 255, "
                f"{100 * one.saturated:.1f} % saturated"
            )
        return lines


def tune(
    client: ControlClient,
    publish: str,
    lamp: str = "projector",
    *,
    keys: ClientKeys | None = None,
    camera: int = 0,
    steps: int = STEPS,
    frames: int = FRAMES,
    progress: Progress = lambda what, done, total: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Tuned:
    """One lamp, as one camera sees it, of an idle head, which is idle again afterwards.

    publish : the daemon's address of topics, `keys` for it. Raises AnnulusError with why nothing is proposed, Cancelled
    when `cancelled` says so.
    """
    if lamp not in LAMPS:
        raise AnnulusError(f"lamp {lamp!r}: expected one of {', '.join(LAMPS)}")
    begun = time.monotonic()
    about = client.about()
    reported = untrusted.mapping(about.get("timing"), "timing")
    timing = FrameTiming(
        *(untrusted.number(reported.get(name), name, 1e6) for name in ("fps", "exposure_us", "readout_us"))
    )
    lamps = untrusted.mapping(about.get("lamps"), "lamps")
    delay, width = (untrusted.number(lamps.get(f"{lamp}_{what}_us"), what, 1e6) for what in ("delay", "width"))
    if width <= 0.0:
        raise AnnulusError(f"tune: the {lamp} has no flash, {lamp}_width_us is 0: give it a width first")
    settings = delays(timing, width, steps)
    total = len(settings) + 3
    with _Watch(publish, keys, camera, LAMPS[lamp]) as watch, _trial(client) as trial:
        work = _Work(client, trial, watch, lamp, frames, timing.period_us, cancelled)
        progress("waiting for frames", 0, total)
        watch.first(work.turn)
        readings = []
        for n, at in enumerate([*settings, settings[len(settings) // 2]]):
            readings += work.read(at, width)
            progress(f"{lamp} at {at:.0f} us", n + 1, total)
        proposal = find(readings, timing, delay, width, watch.height)
        tried = work.read(proposal.delay_us, proposal.width_us)
        progress("proposed flash", total, total)
        proposal = confirmed(proposal, tried[-1])
    return Tuned(lamp, proposal, (*readings, *tried), time.monotonic() - begun)


def delays(timing: FrameTiming, width_us: float, steps: int) -> list[float]:
    """At which a flash is tried: the window, and somewhat beyond it on both sides, within the frame."""
    beyond = BEYOND * timing.readout_us
    first = max(timing.opens_us - beyond, 0.0)
    last = min(timing.closes_us + beyond, timing.period_us - 1.0) - width_us
    if last <= first:
        raise AnnulusError(f"tune: a flash of {width_us:.0f} us leaves no room to move it in ({timing}): shorten it")
    return [float(round(at)) for at in np.linspace(first, last, steps)]


@contextlib.contextmanager
def _trial(client: ControlClient) -> Iterator[int | None]:
    """Lamps on; its number. Ended whatever happens: the daemon has the former lamps then. No other is ended: somebody
    may have ended this one, and have begun a scan since.
    """
    client.trial(HOLD_S)
    trial = client.scan
    try:
        yield trial
    finally:
        with contextlib.suppress(AnnulusError):  # it ended by itself
            client.stop(scan=trial)


class _Work:
    def __init__(
        self,
        client: ControlClient,
        trial: int | None,
        watch: "_Watch",
        lamp: str,
        frames: int,
        period_us: float,
        cancelled: Callable[[], bool],
    ) -> None:
        self._client, self._trial, self._watch, self._lamp, self._frames = client, trial, watch, lamp, frames
        self._patience_s = PATIENCE_S + PATIENCE_PERIODS * period_us * 1e-6
        self._cancelled = cancelled
        self._renew_s = 0.0

    def turn(self) -> None:
        """Often: the trial goes on, unless it was cancelled."""
        if self._cancelled():
            raise Cancelled("tune: cancelled, the lamps are as they were")
        if time.monotonic() > self._renew_s:
            self._client.hold(HOLD_S, scan=self._trial)
            self._renew_s = time.monotonic() + RENEW_S

    def read(self, delay_us: float, width_us: float) -> list[Reading]:
        """Of a setting: one reading of frames that follow another of the lamp, or one of those that do not."""
        self.turn()
        self._client.lamps(
            commit=True,
            trial=True,
            scan=self._trial,
            **{f"{self._lamp}_delay_us": delay_us, f"{self._lamp}_width_us": width_us},
        )
        seen = self._watch.gather(self._frames, self._patience_s, self.turn)
        if seen is None:
            raise AnnulusError(
                f"tune: no labelled frame of the {self._lamp} within {self._patience_s:.0f} s at {delay_us:.0f} us: "
                "see the daemon's events"
            )
        follows, bands, saturated = seen
        return [Reading(delay_us, width_us, bands, saturated, follows)]


class _Watch:
    """Labels and light of rows of one camera."""

    def __init__(self, address: str, keys: ClientKeys | None, camera: int, label: Label) -> None:
        self._camera, self._label = camera, label
        self._labels: dict[int, Label] = {}
        self._newest = -1  # edge
        self.height = 1  # rows of the picture
        self._rows: list[tuple[int, np.ndarray[tuple[int], np.dtype[np.float64]], float]] = []
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        try:
            self._socket = connected(self._context, zmq.SUB, address, keys, MESSAGE_MAX)
        except AnnulusError:
            self._context.destroy(linger=0)
            raise
        self._socket.subscribe(b"label")
        self._socket.subscribe(f"rows/{camera}".encode())

    def __enter__(self) -> "_Watch":
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy(linger=0)

    def first(self, turn: Callable[[], None]) -> None:
        """Until the lamp was seen at all."""
        if not self._until(lambda: bool(self._rows), UP_S, turn):
            raise AnnulusError(f"tune: no labelled frame of the lamp within {UP_S:.0f} s: see the daemon's events")

    def gather(
        self, count: int, patience_s: float, turn: Callable[[], None]
    ) -> tuple[bool, np.ndarray[tuple[int], np.dtype[np.float64]], float] | None:
        """Whether they follow a frame of the same lamp, their median light, their saturation; None: too few came."""
        self._listen(0)
        self._rows.clear()
        after = self._newest + SKIPPED

        def groups() -> dict[bool, list[int]]:
            found: dict[bool, list[int]] = {True: [], False: []}
            for n, (edge, _, _) in enumerate(self._rows):
                before = self._labels.get(edge - 1)
                if edge > after and before is not None and before is not Label.UNKNOWN:
                    found[before is self._label].append(n)
            return found

        if not self._until(lambda: max(map(len, groups().values())) >= count, patience_s, turn):
            return None
        follows, which = max(groups().items(), key=lambda group: len(group[1]))
        light = np.median([self._rows[n][1] for n in which], axis=0)
        return follows, light, float(np.median([self._rows[n][2] for n in which]))

    def _until(self, there: Callable[[], bool], patience_s: float, turn: Callable[[], None]) -> bool:
        end = time.monotonic() + patience_s
        while not there():
            if time.monotonic() > end:
                return False
            turn()
            self._listen(50)
        return True

    def _listen(self, wait_ms: int) -> None:
        while self._socket.poll(wait_ms):
            wait_ms = 0
            with contextlib.suppress(ValueError):  # not for us to count
                topic, _, body, part = parse(self._socket.recv_multipart())
                self._take(topic, untrusted.mapping(body, topic), part)

    def _take(self, topic: str, body: Mapping[str, object], part: bytes) -> None:
        edge = body.get("edge")
        if body.get("camera", 0) != self._camera or not isinstance(edge, int):
            return
        label = Label(untrusted.text(body.get("label"), "label", 32))
        self._labels[edge] = label
        if topic == "label":
            self.height = untrusted.whole(body.get("height"), "height", 1, 1 << 16)
        self._newest = max(self._newest, edge)
        while len(self._labels) > QUEUE:
            del self._labels[next(iter(self._labels))]
        if topic.startswith("rows/") and label is self._label:
            light = np.frombuffer(part, "<f4").astype(np.float64)
            self._rows.append((edge, light, untrusted.number(body.get("saturated", 0.0), "saturated", 1.0)))
            del self._rows[:-QUEUE]
