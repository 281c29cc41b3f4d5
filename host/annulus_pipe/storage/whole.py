"""A file that appears whole or not at all: written beside its place, then renamed."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from annulus_pipe.untrusted import require_replaceable
from annulus_pipe.vocabulary import AnnulusError


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[BinaryIO]:
    """A file to be written and read, which is `path` when the block ends well; otherwise `path` stays as it was.

    A link stays one, and the file that it leads to is replaced. Its mode follows the umask, as of any file that is
    opened (a file of `tempfile` would be the owner's alone). Raises AnnulusError where a device, a pipe or a folder
    stands there, OSError where the folder cannot be written.
    """
    try:
        require_replaceable(path)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None
    place = Path(os.path.realpath(path))
    temporary = place.with_name(f".{place.name}.{os.getpid()}.part")
    try:
        with temporary.open("w+b") as file:
            yield file
        temporary.replace(place)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
