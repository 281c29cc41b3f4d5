"""Promises of a scan that is looked at: whatever becomes of console, network and viewers, it goes on as without them.
The long form, with a cut of a minute, is `python -m tools.bench.speed.console_faults`.
"""

import pytest

from tools.bench.speed import console_faults as faults

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(gate="tests/unit/console/test_serving.py::test_a_daemon_that_goes_and_comes_back_is_another"),
]


def test_a_scan_goes_on_whatever_becomes_of_console_network_and_viewers() -> None:
    """Ten viewers of which one never reads, the others stopped for a while, the network cut, the console killed."""
    outcome = faults.struck(calm_s=4.0, suspended_s=3.0, cut_s=3.0)
    assert outcome.problems == []
    assert faults.unlike(outcome) == []
    assert outcome.seen_again["status"] > 1.0  # the next console shows it again
    assert list(outcome.phases) == [
        faults.CALM,
        faults.LOOKED_AT,
        faults.SUSPENDED,
        faults.CUT,
        faults.KILLED,
        faults.AFTER,
    ]
