"""Who ties methods to instruments: one head, run until told to stop."""

from pathlib import Path


def run_daemon(config: Path, log: Path | None = None) -> int:
    """`annulus daemon`: scan until Ctrl-C."""
    from annulus.daemon.run import run_daemon as run  # late: worker processes live in this package and need none of it

    return run(config, log)
