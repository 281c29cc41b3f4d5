"""A child process that does not outlive its parent, however either of them ends, and however early.

    subprocess.Popen([*child("annulus_pipe.daemon.worker"), json.dumps({"parent": os.getpid(), ..})])

The child asks the kernel for a signal at its parent's death before it imports anything else: SIGKILL, as long as it has
nothing to close. Who has asks again, by `end_with_parent`.
"""

import ctypes
import json
import os
import runpy
import signal
import sys
import threading
from pathlib import Path

NO_MEMORY = 71  # exit status of a child that was refused memory
_PR_SET_PDEATHSIG = 1


def child(module: str) -> list[str]:
    """The command that runs `module` as a child; to be followed by one argument, JSON with `parent`, a process id."""
    return [sys.executable, "-c", "from annulus_pipe.stream.orphan import run; run()", module]


def run() -> None:
    """What that command does."""
    module, argument = sys.argv[1:]
    end_with_parent(json.loads(argument)["parent"], signal.SIGKILL)
    sys.argv[:] = [module, argument]
    sys.unraisablehook = _unraisable
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except MemoryError:  # whatever could be closed is; its owner says so, in one line, which needs memory too
        os._exit(NO_MEMORY)


def _unraisable(what: "sys.UnraisableHookArgs") -> None:
    """Without memory the interpreter itself has much to say that nobody can use."""
    if not isinstance(what.exc_value, MemoryError) and what.exc_type is not MemoryError:
        sys.__unraisablehook__(what)


def end_with_parent(parent: int, by: signal.Signals = signal.SIGTERM) -> None:
    """Have the kernel send this signal when the parent is gone, even by kill -9, and even to a process that is stopped:
    a stopped one is continued, for any signal but SIGKILL would wait in front of it for ever.
    """
    _at_parents_death(by)
    if by is not signal.SIGKILL:
        asked = threading.Event()
        threading.Thread(target=_continue_with_parent, args=(asked,), name="continue", daemon=True).start()
        asked.wait()
    if is_dead(parent):  # .. before we asked
        sys.exit(1)


def is_dead(parent: int) -> bool:
    """Or dying: its other threads may take a moment longer, and are our parent until then."""
    try:
        return os.getppid() != parent or Path(f"/proc/{parent}/stat").read_text().rsplit(") ", 1)[1][0] in "ZX"
    except OSError:
        return True


def _at_parents_death(number: signal.Signals) -> None:
    """Of the calling thread's: each thread may ask for a signal of its own, and the process gets them all."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


def _continue_with_parent(asked: threading.Event) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # the others' signals are to interrupt them
    _at_parents_death(signal.SIGCONT)
    asked.set()
    threading.Event().wait()
