"""Real-time priority for a thread that must be in time, where the system allows it.

SCHED_FIFO comes before everything that is not real-time, and before nothing of the kernel that frames and bytes need.
Who is started by such a thread is not real-time, and raises itself where it must be: a camera's intake as the loop, the
recorder below them, so that it holds up nobody who feeds it, the publisher below that. Workers, whose work can be done
later, are never. The system's own limit (950 ms in each second) keeps a loop gone wild from taking the machine with it.

A thread is in time only with those that it waits for. Others of its interpreter hold the lock that it needs, and one
that is not let run while it holds it stops the loop (50 ms and more at load 3): `share_priority`. What it sends to
another process goes through a thread of libzmq's: `prompt`.
"""

import os
import resource
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import zmq

LEVEL = 10  # of 1..99; a kernel's interrupt threads run at 50
RECORDER_LEVEL = 7  # after the loop and the cameras' intakes, which feed it; before who only looks on
PUBLISHER_LEVEL = 5  # of one that strangers talk to: after the loop, before what is not real-time
ALLOWED = 0.3  # of one core, within a second, that such a one may need; it usually needs 0.05
ALLOWED_RUN_US = 400_000  # .. and at one stretch, before the kernel ends it
AUTOGROUP = Path("/proc/sys/kernel/sched_autogroup_enabled")
_RLIMIT_RTTIME = 15  # resource has no name for it
_REALTIME = (os.SCHED_FIFO, os.SCHED_RR)


def raise_priority(wanted: bool | None = None, level: int = LEVEL) -> str:
    """SCHED_FIFO for the calling thread. `wanted` as head.toml says: False does nothing, None takes what is allowed.

    Returns a remark for people: what was refused, and what would allow it; empty when there is nothing to say.
    """
    if wanted is False:
        return ""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))
    except OSError as error:
        return (
            f"no real-time priority ({error.strerror}): frames may be late, and not be recorded, when the machine is "
            "busy. Allow it with LimitRTPRIO=20 in the unit, or rtprio in /etc/security/limits.conf; "
            "[daemon] realtime = false does without."
        )
    return ""


def raise_process(wanted: bool | None, level: int) -> bool:
    """SCHED_FIFO for the calling thread and those of libzmq, which hand it what it works on. Whether it was given."""
    if wanted is False or raise_priority(wanted, level):
        return False
    _set(_tasks(), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))
    return True


def autogroup_remark() -> str:
    """What is to be said of a kernel that shares its time among sessions first, and then among who is in each: its own
    workers, which hand on what a tty brings, then wait three times as long on a busy machine (decision 28).
    """
    with suppress(OSError):
        if AUTOGROUP.read_text().strip() == "1":
            return "; edges on a serial line are sooner with sysctl kernel.sched_autogroup_enabled=0"
    return ""


def is_realtime() -> bool:
    """Whether the calling thread is."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in _REALTIME


def share_priority() -> None:
    """The calling thread's priority for all threads that run Python here, if it is real-time: they share one lock."""
    if is_realtime():
        own = threading.get_native_id()
        others = [thread.native_id for thread in threading.enumerate()]
        _set([one for one in others if one not in (None, own)], os.sched_getscheduler(0), os.sched_getparam(0))


def prompt(context: "zmq.Context[zmq.Socket[bytes]]") -> "zmq.Context[zmq.Socket[bytes]]":
    """The calling thread's priority for the context's own threads, if it is real-time. Before its first socket. Where
    strangers reach its sockets, only within a ProcessorAllowance.
    """
    if is_realtime():
        context.set(zmq.THREAD_SCHED_POLICY, os.SCHED_FIFO)
        context.set(zmq.THREAD_PRIORITY, os.sched_getparam(0).sched_priority)
    return context


class ProcessorAllowance:
    """Real-time priority for a process that strangers talk to, its thread and libzmq's, as long as it needs little.
    Whoever makes it work hard makes it an ordinary process, for a second at least, and nothing else late. One that does
    not come back from a call at all is ended by the kernel; its owner starts another.
    """

    def __init__(
        self,
        wanted: bool | None,
        now_s: Callable[[], float] = time.monotonic,
        used_s: Callable[[], float] = time.process_time,
    ) -> None:
        self.exceeded = 0  # times
        self._now_s, self._used_s = now_s, used_s
        self._looked_s, self._used = now_s(), used_s()
        self._raised = False
        self._allowed = raise_process(wanted, PUBLISHER_LEVEL)
        if self._allowed:
            with suppress(OSError, ValueError):
                resource.setrlimit(_RLIMIT_RTTIME, (ALLOWED_RUN_US, ALLOWED_RUN_US))
            self._raised = True

    @property
    def raised(self) -> bool:
        return self._raised

    def look(self) -> None:
        """Call often. Does nothing more than once a second."""
        now_s = self._now_s()
        if not self._allowed or now_s - self._looked_s < 1.0:
            return
        used = self._used_s()
        share = (used - self._used) / (now_s - self._looked_s)
        self._looked_s, self._used = now_s, used
        if share <= ALLOWED:
            self._raised = raise_process(True, PUBLISHER_LEVEL)  # threads that are new, too
        elif self._raised:
            self._raised = False
            self.exceeded += 1
            _set(_tasks(), os.SCHED_OTHER, os.sched_param(0))


def _tasks() -> list[int]:
    """The calling thread and libzmq's. One of those that has no name yet is about to read what it is and to write it
    back; it aborts the process when it is something else by then.
    """
    named = [task for task in Path("/proc/self/task").iterdir() if _name(task).startswith("ZMQbg")]
    return [threading.get_native_id(), *(int(task.name) for task in named)]


def _name(task: Path) -> str:
    try:
        return (task / "comm").read_text()
    except OSError:  # it has ended
        return ""


def _set(threads: Iterable[int | None], policy: int, param: os.sched_param) -> None:
    for thread in threads:
        if thread is not None:
            with suppress(OSError):  # it has ended, or is not to be
                os.sched_setscheduler(thread, policy, param)
