"""Two receivers of another lab that stood side by side, and so heard the same, were called a stage that did not move,
and left out (f6abe97). Fails when neighbours of any distance are compared."""

import numpy as np

from annulus_pipe.wings.tai.measure.sweep import Sweep, examine

TURN = np.linspace(0.0, 270.0, 28)


def sweep(angles_deg: np.ndarray) -> Sweep:
    """What each receiver hears of one point off the middle: a pulse at its own time of flight."""
    turn = np.radians(angles_deg)
    way = np.hypot(12.0 * np.cos(turn) - 6.0, 12.0 * np.sin(turn))
    times = np.arange(400) / 20e6
    signals = np.exp(-(((times[None] - way[:, None] * 1e-3 / 1500.0) / 2e-7) ** 2))
    return Sweep(signals + 1e-4 * np.random.default_rng(1).normal(size=signals.shape), angles_deg, 12.0, 20e6)


def test_receivers_side_by_side_may_hear_the_same() -> None:
    close = np.sort(np.append(TURN, TURN[9] + 0.05))
    assert not [fault for fault in examine(sweep(close)) if fault.kind == "same place"]


def test_a_stage_that_did_not_move_is_still_found() -> None:
    heard = sweep(TURN)
    heard.signals[12] = heard.signals[11]
    (stuck,) = [fault for fault in examine(heard) if fault.kind == "same place"]
    assert stuck.positions == (12,)
