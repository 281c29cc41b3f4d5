"""Promises of a scan whose processes are killed and stopped, each once; the whole matrix, twenty times each and with
disks, is `python -m tools.bench.speed.kills`.
"""

import pytest

from tools.bench.speed import blows, daemons

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(
        gate="tests/system/test_camera_gone.py::test_an_intake_that_is_killed_or_stopped_is_replaced_and_its_slots_come_back"
    ),
]

SOON_S = 2.0  # measured at a load of 12: 0.7


def test_whoever_is_killed_or_stopped_is_replaced_soon_and_every_frame_is_accounted_for() -> None:
    chosen = [blow for blow in blows.process_blows() if "spare" not in blow.name]
    chosen += [blow for blow in blows.other_blows() if blow.name == "folder removed"]
    outcome = blows.struck(chosen)
    assert outcome.problems == []
    assert max(took for times in outcome.took_s.values() for took in times) <= SOON_S, outcome.took_s


@pytest.mark.parametrize("children_stopped", [False, True])
def test_a_killed_daemon_leaves_lamps_dark_and_nothing_behind(children_stopped: bool) -> None:
    outcome = daemons.killed(1, children_stopped)
    assert outcome.problems == []
    assert outcome.dark_s[0] <= daemons.DARK_S


def test_a_stopped_daemon_is_dark_meanwhile_and_scans_on_when_it_is_continued() -> None:
    outcome = daemons.stopped(1, daemons.STOP_S)
    assert outcome.problems == []
    assert outcome.dark_s[0] <= daemons.DARK_S and outcome.took_s[0] <= SOON_S
