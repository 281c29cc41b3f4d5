"""Promises of the surveyor: what it finds keeps its number, what a window's ends do not show is not believed, what is
missed is counted, and one that takes over goes on.
"""

import math
import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import zmq

from annulus_pipe.daemon import found
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.found import Findings, frames_of, is_same
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.publishing import Publishing
from annulus_pipe.daemon.surveying import UNHEARD_MAX, Surveying
from annulus_pipe.daemon.surveyor import OVERLAP, STEP, WAITING, WINDOW, ProfileWindow
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import Shared
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey
from tests.unit.daemon import test_live_wall as live

D = 150.0
DENT = Defect(Kind.BUMP, 500.0, 90.0, 30.0, 40.0, 3.0, 900.0, True, 0.2)


def a_survey(low: float, high: float, *defects: Defect) -> Survey:
    some = {
        "scanned_mm": (low, high),
        "defects": defects,
        "profiles": (),
        "diameter_mean_mm": 152.0,
        "diameter_k2_mm": 0.1,
    }
    return cast(Survey, SimpleNamespace(**some))


def a_profile(frame: int, z_mm: float, points: Any = ((0.0, 0.0, 0.0),)) -> Profile:
    n = len(points)
    nothing = np.zeros(n, np.uint8)
    return Profile(
        frame,
        z_mm,
        Pose(0.0, 0.0, 0.0, 0.0),
        np.array(points, np.float32),
        np.zeros((n, 3), np.uint8),
        nothing,
        nothing.astype(np.uint16),
    )


def findings(monkeypatch: Any) -> Findings:
    monkeypatch.setattr(found, "closeup", lambda number, *_: ({"id": number}, b""))
    return Findings(D)


def test_a_defect_keeps_its_number_while_it_is_found_at_its_place(monkeypatch) -> None:
    all_of_it = findings(monkeypatch)
    assert [one.id for one in all_of_it.look(a_survey(0, 800, DENT), 1, True, False)] == [1]
    better = replace(DENT, z_mm=501.0, depth_mm=3.2)
    assert [one.id for one in all_of_it.look(a_survey(100, 900, better), 1, False, False)] == [1]
    assert not all_of_it.look(a_survey(150, 950, better), 1, False, False)  # nothing new is said
    other = replace(DENT, z_mm=560.0)
    assert [one.id for one in all_of_it.look(a_survey(150, 950, better, other), 1, False, False)] == [2]
    said = all_of_it.to_dict(9)
    assert [one["id"] for one in said["defects"]] == [1, 2] and said["defects"][0]["depth_mm"] == 3.2
    assert said["scan"] == 9 and said["diameter_mm"] == 152.0 and said["looked_mm"] == [0, 950 - 0.5 * D]


def test_the_ends_of_a_window_say_nothing_of_what_was_known(monkeypatch) -> None:
    all_of_it = findings(monkeypatch)
    all_of_it.look(a_survey(0, 800, DENT), 1, True, False)
    all_of_it.look(a_survey(400, 1200), 1, False, False)  # less than 1.5 diameters behind its beginning
    assert len(all_of_it.known) == 1
    all_of_it.look(a_survey(100, 900), 1, False, False)  # its middle: there is nothing after all
    assert not all_of_it.known


def test_what_the_head_has_not_passed_yet_is_not_listed_before_the_scan_is_over(monkeypatch) -> None:
    for way, low, high in ((1, 0, 520), (-1, 480, 1000)):
        all_of_it = findings(monkeypatch)
        assert not all_of_it.look(a_survey(low, high, DENT), way, True, False)
        assert all_of_it.look(a_survey(low, high, DENT), way, True, True)


def test_one_that_takes_over_knows_what_was_told_and_numbers_on(monkeypatch) -> None:
    before = findings(monkeypatch)
    before.look(a_survey(0, 800, DENT, replace(DENT, z_mm=300.0, depth_k2_mm=math.nan)), 1, True, False)
    after = findings(monkeypatch)
    after.take_over(before.to_dict(9))
    assert after.to_dict(9)["defects"] == before.to_dict(9)["defects"]
    assert [one.id for one in after.look(a_survey(0, 2000, replace(DENT, z_mm=1500.0)), 1, False, False)] == [3]


def test_at_most_five_hundred_are_listed_and_they_are_the_deepest(monkeypatch) -> None:
    many = [replace(DENT, z_mm=100.0 * n, depth_mm=1.0 + n / 1000) for n in range(600)]
    all_of_it = findings(monkeypatch)
    all_of_it.look(a_survey(-1000, 100_000, *many), 1, True, True)
    assert len(all_of_it.known) == 500 and min(one.defect.depth_mm for one in all_of_it.known) == 1.1


def test_same_is_the_same_kind_at_the_same_place() -> None:
    assert is_same(DENT, replace(DENT, z_mm=520.0, clock_deg=120.0), D)
    assert not is_same(DENT, replace(DENT, kind=Kind.LOSS), D)
    assert not is_same(DENT, replace(DENT, z_mm=540.0), D)
    assert not is_same(DENT, replace(DENT, clock_deg=140.0), D)
    assert is_same(replace(DENT, clock_deg=355.0), replace(DENT, clock_deg=20.0), D)


def test_the_frames_of_a_defect_are_those_with_points_there() -> None:
    there, beside, behind = ((76.0, 0.0, 505.0),), ((-76.0, 0.0, 505.0),), ((76.0, 0.0, 520.0),)
    profiles = [a_profile(n, 0.0, there if n % 3 == 0 else beside if n % 3 == 1 else behind) for n in range(90)]
    frames = frames_of(DENT, profiles)
    assert len(frames) == 12 and all(frame % 3 == 0 for frame in frames) and frames[0] == 0 and frames[-1] == 87


def test_a_window_moves_on_by_steps_and_overlaps() -> None:
    window = ProfileWindow(D)
    for n in range(STEP - 1):
        window.add(a_profile(n, 3.0 * n))
    assert window.take(final=False) is None
    last = 0
    for n in range(STEP - 1, 3000):
        window.add(a_profile(n, 3.0 * n))
        if (taken := window.take(final=False)) is not None:
            profiles, way, begins, ends = taken
            assert way == 1 and not ends and len(profiles) <= WINDOW
            assert begins is (profiles[0].frame == 0)
            assert profiles[-1].frame == n and profiles[0].frame <= max(0, last - OVERLAP)
            last = n
    assert last >= 2999 - STEP and window.missed == 0
    assert window.take(final=True) is not None and window.take(final=True) is None


def test_profiles_that_wait_too_long_are_counted_and_all_others_looked_at() -> None:
    window, looked = ProfileWindow(D), set()
    for n in range(1000):
        window.add(a_profile(n, 3.0 * n))
    while (taken := window.take(final=True)) is not None:
        looked |= {profile.frame for profile in taken[0]}
        assert len(taken[0]) <= WINDOW
    assert window.missed == 1000 - WAITING and looked == set(range(1000 - WAITING, 1000))


def test_where_the_place_was_set_anew_a_window_begins() -> None:
    window = ProfileWindow(D)
    for n in range(60):
        window.add(a_profile(n, 3.0 * n if n < 20 else 5000.0 + 3.0 * n))
    profiles, _, begins, _ = window.take(final=False) or ([], 0, False, False)
    assert [profile.frame for profile in profiles] == list(range(20, 60)) and begins
    assert window.missed == 20


@pytest.mark.deep(
    gate="tests/unit/daemon/test_surveyor.py::test_a_defect_keeps_its_number_while_it_is_found_at_its_place"
)
def test_a_dent_is_told_of_while_the_scan_is_under_way_and_keeps_its_number_when_the_surveyor_is_killed(
    tmp_path: Path, stalls: Any
) -> None:
    """However long it takes: it has the lowest priority."""

    def dent(clock: Any, z: Any) -> Any:
        return np.where((np.abs(clock - 90.0) < 20.0) & (np.abs(z - 520.0) < 20.0), -4.0, 0.0)

    context, ring, account, events = zmq.Context(), FrameRing(2, 1200), Account(), []
    shared, heard = Shared(ring, context, tmp_path), []
    told = SimpleNamespace(made=lambda topic, body, part: heard.append((topic, body, part)))
    observer = SimpleNamespace(event=lambda kind, text: events.append(kind))
    surveying = Surveying(live.CALIBRATION, shared, account, cast(Observer, observer), cast(Publishing, told))

    def until(done: Any) -> None:
        end = time.monotonic() + 300.0
        while not done():
            assert time.monotonic() < end and not surveying.broken, (events, surveying.broken)
            surveying.poll()
            time.sleep(0.02)

    try:
        surveying.begun(77)
        until(lambda: surveying.ready)
        for z in np.arange(0.0, 600.0, 1.0):
            surveying.profile(live.profile(float(z), bump=dent))
            until(lambda: surveying.unheard < 50)
        assert surveying.pids
        until(lambda: any(topic == "closeup" for topic, _, _ in heard))
        surveying.ended(cast(Any, None))
        lists = [body for topic, body, _ in heard if topic == "defects"]
        (one,) = lists[-1]["defects"]
        assert one["kind"] == "bump" and abs(one["depth_mm"] - 4.0) < 0.3 and one["clock"] == "3:00" and one["id"] == 1
        assert abs(one["z_mm"] - 520.0) < 5.0 and 1 <= len(one["frames"]) <= 12 and lists[-1]["scan"] == 77
        body, png = next((body, part) for topic, body, part in heard if topic == "closeup")
        section = np.frombuffer(body["section_mm"], "<f4")
        assert png[:4] == b"\x89PNG" and len(section) == 360 and abs(section[90] - (live.RADIUS_MM - 4.0)) < 0.3
        pids = surveying.pids
        os.kill(pids[0], signal.SIGKILL)
        until(lambda: surveying.ready and surveying.pids != pids)
        assert account.drops["surveyors_replaced"] == 1 and "surveyor_died" in events
        heard.clear()
        until(lambda: any(topic == "defects" for topic, _, _ in heard))
        assert [one["id"] for one in heard[0][1]["defects"]] == [1]
        surveying.profile(live.profile(700.0))
        os.kill(surveying.pids[0], signal.SIGSTOP)
        began = time.monotonic()
        for z in np.arange(700.0, 1300.0, 3.5):
            surveying.profile(live.profile(float(z)))
        took_s = time.monotonic() - began
        if stalls.since(began) < 0.1:
            assert took_s < 2.0, "nobody waits for it"
        assert account.drops["surveyor_notes"] >= 171 - UNHEARD_MAX
    finally:
        surveying.stop(0.0)
        context.destroy(linger=0)
        ring.close()
