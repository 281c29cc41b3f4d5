"""Promises of the account: what was taken is accounted for, and every loss has a name and a line in the README."""

from pathlib import Path

import pytest

from annulus_pipe.daemon.account import LOSSES, Account
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import Label


def header(label: Label, reason: str = "") -> FrameHeader:
    return FrameHeader(0, None, 0, label, reason, None, None, None, None, "mono8", 4, 4)


def test_a_frame_is_in_hand_until_it_is_somewhere() -> None:
    account = Account()
    account.taken += 4
    account.lose("no_slot")
    assert account.in_hand == {"label": 3, "recorder": 0, "workers": 0}
    for label in (Label.PROJECTOR, Label.LED, Label.UNKNOWN):
        account.label(header(label, "no edge near" if label is Label.UNKNOWN else ""))
        account.to_record += 1
    account.to_profile += 1
    assert account.in_hand == {"label": 0, "recorder": 3, "workers": 1}
    account.recorded += 1
    account.lose("disk")
    account.lose("recorder_died")
    account.profile(12.0)
    assert account.in_hand == {"label": 0, "recorder": 0, "workers": 0}
    report = account.report({})
    assert report.frames == {"projector": 1, "led": 1, "unknown": 1} and report.unknown == {"no edge near": 1}
    assert report.drops == {"disk": 1, "no_slot": 1, "recorder_died": 1}
    assert (report.profiles, report.latency_ms, report.seconds) == (1, 12.0, 0.0)


def test_the_next_scan_begins_at_zero() -> None:
    account = Account()
    account.taken, account.to_record = 3, 2
    account.lose("camera", 5)
    account.label(header(Label.LED))
    account.begin()
    account.restart()
    assert account.in_hand == {"label": 0, "recorder": 0, "workers": 0}
    assert account.drops == {} and account.labelled == 0 and account.seconds == 0.0


def test_a_loss_nobody_has_heard_of_is_refused() -> None:
    with pytest.raises(ValueError, match="no_slots"):
        Account().lose("no_slots")


def test_every_loss_is_in_the_readme() -> None:
    readme = (Path(__file__).parents[3] / "host/annulus_pipe/daemon/README.md").read_text()
    for kind, what in LOSSES.items():
        assert f"| `{kind}` | {what} |" in readme, kind
