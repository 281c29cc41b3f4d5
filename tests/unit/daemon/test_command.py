"""Promises of the command: one changes things, the others see who, and nobody can keep it by going away."""

import pytest

from annulus_pipe.daemon.command import COMMAND_S, CommandLease, Operator
from annulus_pipe.vocabulary import AnnulusError

ANNA, BEN = Operator("a", "Anna"), Operator("b", "Ben")


def test_whoever_commands_is_named_to_the_others() -> None:
    command = CommandLease()
    command.require(None, 0.0)  # nobody commands: everybody may
    assert command.ask(ANNA, 0.0, take=False) == "Anna commands"
    for other in (BEN, None):
        with pytest.raises(AnnulusError, match="Anna commands"):
            command.require(other, 1.0)
    command.require(ANNA, 1.0)
    with pytest.raises(AnnulusError, match="Anna commands"):
        command.ask(BEN, 1.0, take=False)
    assert command.numbers(4.0) == {"name": "Anna", "id": command.public_id(ANNA), "since_s": 4.0}


def test_it_ends_by_itself_and_lasts_while_it_is_renewed() -> None:
    command = CommandLease()
    command.ask(ANNA, 0.0, take=False)
    for at in range(1, 100):
        assert command.ask(ANNA, float(at), take=False) == ""
    command.require(BEN, 99.0 + COMMAND_S)
    assert command.numbers(99.0 + COMMAND_S) is None
    assert command.ask(BEN, 99.0 + COMMAND_S, take=False) == "Ben commands"


def test_it_can_be_taken_and_everybody_hears_from_whom() -> None:
    command = CommandLease()
    command.ask(ANNA, 0.0, take=False)
    assert command.ask(BEN, 1.0, take=True) == "Ben commands, taken from Anna"
    assert command.release(ANNA, 1.0) == "", "who does not hold it gives nothing back"
    with pytest.raises(AnnulusError, match="Ben commands"):
        command.require(ANNA, 2.0)
    assert command.release(BEN, 3.0)
    command.require(ANNA, 3.0)
    with pytest.raises(AnnulusError, match="who asks"):
        command.ask(None, 3.0, take=True)
