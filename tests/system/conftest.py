"""What a program leaves behind when it is broken off."""

import shutil
from collections.abc import Iterator

import pytest
from leftovers import Traces


@pytest.fixture
def traces() -> Iterator[Traces]:
    traces = Traces()
    yield traces
    shutil.rmtree(traces.temporary)
