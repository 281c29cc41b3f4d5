"""What is printed, with all that a terminal would obey written out: names, marks and answers come from outside."""

import contextlib
import sys
from collections.abc import Iterator
from typing import Any, TextIO

from annulus.untrusted import printable


class _Escaping:
    """A stream of text that lets through line ends and tabs, and no other control character."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        self.stream.write(printable(text, keep="\n\t"))
        return len(text)

    def writelines(self, lines: Iterator[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def escaped() -> Iterator[None]:
    """Whatever is printed meanwhile goes to stdout and stderr escaped; progress bars use `as_it_is`."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Escaping(before[0]), _Escaping(before[1])
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def as_it_is(stream: TextIO) -> TextIO:
    """The stream itself, for one who draws."""
    return stream.stream if isinstance(stream, _Escaping) else stream
