"""Who ties methods to instruments: one head, run until told to stop."""

from collections.abc import Sequence
from pathlib import Path


def run_daemon(config: Path, log: Path | None = None, job: Sequence[str] = ()) -> int:
    """`annulus daemon`: scan until Ctrl-C."""
    from annulus.daemon.run import run_daemon as run  # late: worker processes live in this package and need none of it

    return run(config, log, job)
