"""One guest a session: its boot is the dearest part."""

from collections.abc import Iterator

import pytest
from machine import Guest


@pytest.fixture(scope="session")
def guest() -> Iterator[Guest]:
    """A booted machine; drivers are loaded by who needs them. What a test leaves running, the next one meets."""
    with Guest() as guest:
        yield guest
