"""What a fuzzer finds beside a reader that raises."""


class Silent(Exception):
    """What came out is not what went in, and nothing was told."""
