"""Ctrl-C and SIGTERM at any moment: asked for once, obeyed where it is safe."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

AGAIN_S = 0.01  # after which a signal comes again that met native code calling back
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupt:
    """While entered, the signals only set `requested`; inside `allowed()` they raise KeyboardInterrupt at once.

    What acquires or gives back a resource runs outside `allowed()`: a resource is never between hands when the
    signal comes, and asking again does not break off the cleaning up.
    """

    def __init__(self) -> None:
        self.requested = False
        self._allowed = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interrupt":
        for number in _SIGNALS:
            self._before[number] = signal.signal(number, self._hear)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """For work that may be broken off anywhere. Raises at once when the signal has come already."""
        self._allowed = True
        try:
            if self.requested:
                raise KeyboardInterrupt
            yield
        finally:
            self._allowed = False

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        if self._allowed and _is_called_back(frame):
            threading.Timer(AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, number)).start()
        elif self._allowed:
            self._allowed = False  # once: what follows is cleaning up
            raise KeyboardInterrupt


def _is_called_back(frame: FrameType | None) -> bool:
    """Whether LLVM waits for this code: an exception would not reach it, and it would go on with half an object."""
    while frame is not None:
        if frame.f_code.co_name.startswith("_raw_object_cache"):
            return True
        frame = frame.f_back
    return False
