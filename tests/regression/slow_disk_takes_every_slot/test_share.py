"""A disk that stood still let the recorder hold every slot: frames were neither labelled nor shown. Fails when the
recorder may hold as many frames as the ring has slots."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.pools import Recorder, RecordingSetup
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared
from annulus_pipe.vocabulary import Label


class Told(Observer):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def event(self, kind: str, text: str) -> None:
        self.texts.append(text)


def test_a_recorder_that_stands_still_leaves_half_of_the_slots_to_the_others(tmp_path: Path, stalls: Any) -> None:
    context, ring, account, told = zmq.Context(), FrameRing(8, 1200), Account(), Told()
    (sockets := tmp_path / "sockets").mkdir()
    setup = RecordingSetup(tmp_path / "scans", "scan", None, {})
    recorder = Recorder(setup, Shared(ring, context, sockets), account, told)
    end = time.monotonic() + 60.0
    while not recorder.ready:
        assert time.monotonic() < end
        recorder.poll()
        time.sleep(0.01)
    victim = recorder.pids[0]
    os.kill(victim, signal.SIGSTOP)
    begun = time.monotonic()
    for index in range(20):
        place = ring.claim()
        assert place is not None, f"frame {index} found no slot"
        ring.write(place, np.zeros((30, 40), np.uint8))
        header = FrameHeader(index, None, 0, Label.LED, "", None, None, None, 0.0, "mono8", 40, 30)
        account.taken += 1
        account.label(header)
        recorder.offer(header, place)
        ring.release(place)
    absorbs = recorder.absorbs
    if stalls.since(begun) < 0.02:
        assert absorbs, "it was at work a moment ago: who has time may wait"
    time.sleep(0.15)
    assert not recorder.absorbs, "it stands still: nobody waits"
    assert ring.free == 4 and account.drops == {"recorder_busy": 16}
    assert [text for text in told.texts if "falls behind" in text] == told.texts, "once"
    os.kill(victim, signal.SIGCONT)
    recorder.finish(60.0)
    assert account.recorded == 4 and account.ledger.problem == "" and ring.free == 8
    context.destroy(linger=0)
    ring.close()
