"""Promises about evidence: whatever befell a scan, its labels and places are said again from it, to the last field."""

import pytest
from faulty_head import Head

from annulus_pipe.labelling.evidence import LABEL
from annulus_pipe.labelling.replay import PATIENCE_NS, Replay
from annulus_pipe.link.messages import Edge
from annulus_pipe.link.session import EventReceived
from annulus_pipe.record.frames import from_json, to_json
from annulus_pipe.vocabulary import EdgeFlag, Label, Lamp


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(8))
def test_what_was_said_is_said_again(seed: int) -> None:
    head = Head(seed)
    head.run(0, 300)  # nobody writes down: the head is up, no scan is under way
    head.begin()
    head.run(300, 1500)
    known = [header for header in head.headers if header.label is not Label.UNKNOWN]
    assert len(known) > 800 and any(header.z_assumed for header in known)
    replay = Replay()
    again = [one for row in head.rows for one in replay.feed(row)] + replay.finish()
    assert replay.malformed == 0
    assert len(again) == len(head.headers)
    for was, now in again:
        assert now is not None
        said = now.to_dict()
        for name in LABEL:
            if name not in ("index", "roll_deg"):  # numbers go on from scan to scan; roll from samples before the scan
                assert said[name] == was[name], name
    mine = [(header.camera, header.arrived_ns, header.label, header.z_mm, header.segment) for header in head.headers]
    assert mine == [(now.camera, now.arrived_ns, now.label, now.z_mm, now.segment) for _, now in again if now]


def test_a_recorder_that_takes_anothers_place_changes_nothing_and_its_file_can_be_read_alone() -> None:
    head = Head(2)
    head.begin()
    head.run(0, 300)
    first = len(head.rows)
    head.navigation.write_down(lambda row: head.rows.append(from_json(to_json(row))))  # another file
    head.run(300, 900)
    replay = Replay()
    again = [one for row in head.rows for one in replay.feed(row)]
    assert [(now.label, now.z_mm) for _, now in again if now] == [(one.label, one.z_mm) for one in head.headers]
    alone = Replay()
    rest = [one for row in head.rows[first:] for one in alone.feed(row)]
    assert alone.malformed == 0 and sum(now is not None for _, now in rest) > 1000
    for was, now in rest:  # it begins without an offset, and with the same place
        assert now is None or now.label is Label.UNKNOWN or was["label"] == "unknown" or now.z_mm == was["z_mm"]


def test_off_line_a_frame_may_wait_for_what_came_too_late() -> None:
    """On the head there was no room to wait for the offset: 14 frames went without a label."""
    head = Head(1)
    head.rng.random = lambda: 0.5  # type: ignore[method-assign]  # nothing goes wrong
    head.rng.choice = lambda of: of[0]  # type: ignore[method-assign]
    head.begin()
    for labelling in head.labellings:
        labelling.settled = lambda *_: True  # type: ignore[method-assign]
    head.run(0, 60)
    unknown = sum(header.label is Label.UNKNOWN for header in head.headers)
    assert unknown >= 14
    replay = Replay(PATIENCE_NS)
    again = [one for row in head.rows for one in replay.feed(row)] + replay.finish()
    assert sum(now is None or now.label is Label.UNKNOWN for _, now in again) <= 4  # the first and last of each camera
    for was, now in again:
        assert now is not None and was["label"] in ("unknown", now.label.value)


def test_a_row_that_is_missing_costs_its_frame_and_one_that_is_damaged_all_that_is_not_proved_again() -> None:
    head = Head(3)
    head.begin()
    head.run(0, 600)
    frames = [i for i, row in enumerate(head.rows) if row["what"] == "frame"]
    gone, torn = frames[300], frames[400]
    head.rows[torn] = {**head.rows[torn], "picture": "?"}
    del head.rows[gone]
    replay = Replay()
    again = [one for row in head.rows for one in replay.feed(row)] + replay.finish()
    assert replay.malformed == 1 and 2 <= sum(now is None for _, now in again) <= 4
    assert len(again) == len(head.headers)
    for was, now in again:
        assert now is None or now.label is Label.UNKNOWN or now.z_mm == was["z_mm"] or was["z_mm"] is None
    assert sum(now is not None and now.label is not Label.UNKNOWN for _, now in again[-300:]) > 200


def test_an_edge_that_never_got_its_place_in_time_is_written_down_too() -> None:
    head = Head(0)
    head.begin()
    for edge in range(300):
        head.navigation.heard(EventReceived(Edge(edge, edge, 0, Lamp.LED, 1, 1, 0, 1, EdgeFlag(0)), 0, 7, 5, True))
    assert sum(row["what"] == "unplaced" and row["recovered"] for row in head.rows) > 150
