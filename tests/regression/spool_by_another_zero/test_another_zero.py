"""A spool with five defects side by side, matched by a zero 337 mm off: 18 of 60 truths had somebody else's defect
beside them, and a POD was fitted to those."""

import numpy as np
import pytest

from annulus_pipe.qualification.trials import Pull, Reported, TrialState, TrueDefect, match
from annulus_pipe.vocabulary import AnnulusError

PULL = Pull("pull", "", 0.0, 1300.0, 76.2)


def drawn(seed: int) -> tuple[list[TrueDefect], list[Reported]]:
    rng = np.random.default_rng(seed)
    laid, found = [], []
    for row in range(12):
        for clock in rng.uniform(0, 360) + 72.0 * np.arange(5):
            depth = float(rng.uniform(0.2, 0.7))
            laid.append(TrueDefect(f"{len(laid)}", "loss", 210.0 + 80 * row, float(clock % 360), depth, 20.0, 20.0))
            if depth > 0.35:
                found.append(Reported("loss", laid[-1].z_mm + 2, laid[-1].clock_deg, depth, 0.06, 20.0, 15.0))
    return laid, found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("off_mm", [337.0, 80.0, -160.0])
def test_chance_neighbours_are_no_matches(seed: int, off_mm: float) -> None:
    laid, found = drawn(seed)
    with pytest.raises(AnnulusError, match=f"{len(found)} would if their zero lay at 2 mm of the scan"):
        match(laid, found, PULL, zero_mm=off_mm)


@pytest.mark.parametrize("seed", range(4))
def test_the_true_zero_is_taken(seed: int) -> None:
    laid, found = drawn(seed)
    states = [one.state for one in match(laid, found, PULL).trials]
    assert states.count(TrialState.DETECTED) == len(found)
