"""A file that appears whole or not at all: written beside its place, then renamed."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[BinaryIO]:
    """A file to be written and read, which is `path` when the block ends well; otherwise `path` stays as it was.

    Its mode follows the umask, as of any file that is opened (a file of `tempfile` would be the owner's alone). Raises
    OSError where the folder cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("w+b") as file:
            yield file
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
