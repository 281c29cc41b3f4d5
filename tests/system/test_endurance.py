"""Promises of a scan that has to endure much: the rows of `python -m tools.bench.speed.endurance` in their short form,
but for those whose bounds are of a machine with nothing else to do.
"""

import pytest

from tools.bench.speed import endurance

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(
        gate="tests/regression/worker_that_dies_as_it_starts/test_death_loop.py::test_one_that_dies_as_it_starts_is_given_up_told_once_and_tried_again"
    ),
]


def test_dying_workers_no_memory_a_second_daemon_and_operators_cost_a_scan_nothing_that_is_not_told() -> None:
    rows = endurance.rows(["loops", "memory", "second", "tune"], short=True)
    assert [f"{row.what}: {row.measured}" for row in rows if row.ok is False] == []
