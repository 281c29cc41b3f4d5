"""Promises of the ledger: it adds up or says by how much not, and a scan that ended badly has a status of its own."""

from pathlib import Path

import pytest

from annulus_pipe.daemon.account import LOSSES, Account
from annulus_pipe.daemon.ledger import AFTER, BEFORE, LIVE, NO_FRAMES, ExitStatus, Ledger, findings


def ledger(**changes: object) -> Ledger:
    whole = {"taken": 1000, "labelled": 990, "before": {"no_slot": 10}, "recording": True, "recorded": 990, "after": {}}
    return Ledger(**(whole | changes))  # type: ignore[arg-type]


def test_every_kind_of_loss_stands_on_one_side() -> None:
    assert sorted((*BEFORE, *AFTER, *LIVE, *NO_FRAMES)) == sorted(LOSSES)


def test_what_adds_up_is_shown_and_what_does_not_is_said() -> None:
    assert ledger().problem == "" and ledger().lines() == [
        "1000 frames = 990 labelled + 10 lost (10 no_slot) before a label",
        "990 labelled = 990 recorded + 0 lost after it",
    ]
    assert "3 neither labelled nor lost" in ledger(taken=1003).problem
    assert "990 neither recorded nor lost" in ledger(recorded=0).problem
    assert "5 neither recorded nor lost too many" in ledger(after={"disk": 5}).problem
    assert ledger(recording=False, recorded=0).problem == ""


def statuses(one: Ledger, seconds: float = 60.0, dark: bool = True) -> list[ExitStatus]:
    return [finding.status for finding in findings(one, seconds, dark)]


def test_each_bad_end_has_its_status() -> None:
    assert statuses(ledger()) == []
    assert statuses(ledger(recorded=981, after={"disk": 9})) == [], "under 1 % is in the drops, and no failure"
    assert statuses(ledger(recorded=980, after={"recording_gone": 10})) == [ExitStatus.INCOMPLETE]
    assert statuses(ledger(recorded=0, after={"disk": 990})) == [ExitStatus.UNRECORDED]
    assert statuses(ledger(recording=False, recorded=0)) == []
    assert statuses(ledger(taken=1001)) == [ExitStatus.UNBALANCED]
    assert statuses(ledger(), dark=False) == [ExitStatus.NOT_DARK]
    nothing = ledger(taken=0, labelled=0, recorded=0, before={})
    assert statuses(nothing, 60.0) == [ExitStatus.UNRECORDED] and statuses(nothing, 1.0) == []


def test_a_file_that_is_gone_takes_its_frames_along() -> None:
    account = Account()
    account.recording, account.taken, account.to_record, account.recorded = True, 5, 5, 5
    account.frames["led"] = 5
    account.unrecord(3)
    assert account.recorded == 2 and account.drops == {"recording_gone": 3}
    assert account.ledger.problem == "" and account.in_hand["recorder"] == 0
    account.lose("camera", 2)
    account.lose("camera_away", 1)
    assert account.ledger.taken == 8 and account.ledger.problem == ""


@pytest.mark.parametrize("status", ExitStatus)
def test_every_status_is_in_the_readme(status: ExitStatus) -> None:
    readme = (Path(__file__).parents[3] / "host/annulus_pipe/daemon/README.md").read_text()
    assert f"| {status.value} | " in readme
