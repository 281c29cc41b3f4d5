"""The source's table: `python -m tools.source` writes it into docs/manual/source.md from source.toml beside it.

`python -m tools.source inputs KIND FOLDER` draws what a few of its commands begin with, KIND joint, target or fisheye.
`python -m tools.source run [SECTION ..]` runs the commands of the rows whose section begins so, all if none is named,
each once, in a new folder; it ends with status 1 if one of them does not end with 0, or prints other numbers.
"""

import sys
import tempfile
from pathlib import Path

from tools import source
from tools.source import inputs
from tools.source.run import run


def main(arguments: list[str]) -> int:
    """The exit status."""
    match arguments:
        case []:
            source.write()
        case ["inputs", kind, folder] if kind in inputs.KINDS:
            inputs.KINDS[kind](Path(folder))
        case ["run", *sections]:
            with tempfile.TemporaryDirectory() as folder:
                return run(Path(folder), sections)
        case _:
            print(__doc__)
            return 0 if arguments in (["--help"], ["-h"]) else 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
