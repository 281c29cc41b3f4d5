"""Who ties methods to instruments: one head, run until told to stop."""

from collections.abc import Sequence
from pathlib import Path


def run_daemon(config: Path, log: Path | None = None, job: Sequence[str] = ()) -> int:
    """`annulus daemon`: scan until Ctrl-C."""
    from annulus_pipe.daemon.claims import claimed  # late: worker processes live in this package and need none of it
    from annulus_pipe.daemon.config import load_config

    head = load_config(config)
    with claimed(head):
        from annulus_pipe.daemon.run import (
            run_daemon as run,  # later still: it takes a second, and a second daemon ends here
        )

        return run(head, log, job)
