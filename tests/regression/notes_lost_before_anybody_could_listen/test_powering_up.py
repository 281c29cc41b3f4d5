"""While a head powered up, 2002 publisher_notes were counted as lost: nobody could have listened yet."""

from pathlib import Path

import zmq

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import SocketConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.publishing import Publishing
from annulus_pipe.stream.pool_events import Ready
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared


def test_what_is_said_before_the_first_publisher_is_up_is_no_loss(tmp_path: Path) -> None:
    context, ring, account = zmq.Context(), FrameRing(4, 48), Account()
    publishing = Publishing(
        SocketConfig("tcp://127.0.0.1:*", None), Shared(ring, context, tmp_path), account, Observer()
    )
    try:
        for _ in range(5000):  # its process, not up yet, takes none of them
            publishing.event("sensor", "of a start that takes its time")
        assert account.drops == {}
        publishing._happened([Ready(0)])  # from now on somebody may listen
        for _ in range(5000):
            publishing.event("sensor", "of a publisher that stands still")
        assert account.drops["publisher_notes"] > 1000
    finally:
        publishing.stop(0.0)
        context.destroy(linger=0)
        ring.close()
