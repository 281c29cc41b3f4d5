"""The one command, `annulus`: options and words for people. `app` has all of it, `show` what commands share."""

import sys

from annulus_pipe.vocabulary import AnnulusError


def main() -> None:
    """Entry point: one clear line for what a user can mend, exit status 0 only for success."""
    try:
        from annulus_pipe.cli.app import main as run
    except AnnulusError as error:  # a wing that cannot be loaded
        sys.exit(f"annulus: {error}")
    run()
