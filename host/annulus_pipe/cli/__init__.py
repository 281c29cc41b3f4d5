"""The one command, `annulus`: options and words for people. `app` has all of it, `show` what commands share."""


def main() -> None:
    """Entry point: one clear line for what a user can mend, exit status 0 only for success."""
    from annulus_pipe.cli.app import main as run

    run()
