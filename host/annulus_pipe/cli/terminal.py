"""What is printed, with all that a terminal would obey written out: names, marks and answers come from outside.

What stdout does not take ends the command as Unix tools end (`OutputError`); what stderr does not take is lost, and
costs nothing else.
"""

import contextlib
import errno
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, TextIO, cast

from annulus_pipe.untrusted import printable

READER_GONE = 141  # status: as of a program that SIGPIPE ends


class OutputError(Exception):
    """Stdout took no more. Not an OSError, so that no handler takes it for an error of a file."""

    def __init__(self, error: OSError) -> None:
        super().__init__(error.strerror or str(error))
        self.is_read = error.errno != errno.EPIPE  # somebody waits for what is missing


class _Guarded:
    """A stream of text, None where it was closed before we began, and what to do when it fails."""

    def __init__(self, stream: TextIO | None, failed: Callable[[OSError], None]) -> None:
        self.stream, self._failed = stream, failed

    def write(self, text: str) -> int:
        try:
            if self.stream is None:
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            self.stream.write(text)
        except OSError as error:
            self._failed(error)
        return len(text)

    def flush(self) -> None:
        try:
            if self.stream is not None:
                self.stream.flush()
        except OSError as error:
            self._failed(error)

    def writelines(self, lines: Iterator[str]) -> None:
        for line in lines:
            self.write(line)

    def isatty(self) -> bool:
        return self.stream is not None and self.stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


class _Escaping(_Guarded):
    """It lets through line ends and tabs, and no other control character."""

    def write(self, text: str) -> int:
        super().write(printable(text, keep="\n\t"))
        return len(text)


def _end(error: OSError) -> None:
    raise OutputError(error) from None


def _lose(error: OSError) -> None:
    pass


@contextlib.contextmanager
def escaped() -> Iterator[None]:
    """Whatever is printed meanwhile goes to stdout and stderr escaped; progress bars use `as_it_is`."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = cast(TextIO, _Escaping(before[0], _end)), cast(TextIO, _Escaping(before[1], _lose))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def as_it_is(stream: TextIO) -> TextIO:
    """The stream itself, for one who draws; what it does not take is lost."""
    return cast(TextIO, _Guarded(stream.stream, _lose)) if isinstance(stream, _Escaping) else stream


def end_of_output(error: OutputError) -> int:
    """The status to end with; says in one line what is missing, unless nobody reads it."""
    if sys.stdout is not None:
        with contextlib.suppress(OSError, AttributeError):  # what waits in the stream's buffer is not tried again
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if not error.is_read:
        return READER_GONE
    print(f"annulus: stdout: cannot be written ({error}); what it has is not all.", file=sys.stderr)
    return 1
