"""After timestamps moved by a quarter to three quarters of a frame no edge was near any more: no label ever again, and
nobody was told. The same after any doubt at a ratio of 0 or 1. Fails when only pictures can give a proof back."""

import pytest
from bench_of_faults import PERIOD, Bench, Faults

from annulus_pipe.vocabulary import Lamp


@pytest.mark.parametrize("frames", [0.3, 0.5, 0.7, -0.5])
def test_labels_come_back_and_the_operator_is_told(frames: float) -> None:
    score = Bench(Faults(stamp_ms=lambda k: frames * PERIOD / 1e6 * (k >= 200))).run(400)
    assert score.wrong == [] and score.relock(200) <= 8 and score.share(210) == 0
    assert any("doubt" in told for told in score.told)


@pytest.mark.parametrize("ratio", [0, 1])
def test_labels_come_back_at_any_ratio(ratio: int) -> None:
    def lamp(k: int) -> Lamp:
        """Some frames lit in no cycle say which is which at first."""
        if 0 <= k < 16:
            return Lamp.LED if 0b0110100110010111 >> k & 1 else Lamp.PROJECTOR
        return Lamp.LED if ratio and k % 2 else Lamp.PROJECTOR

    score = Bench(Faults(lamp=lamp, stamp_ms=lambda k: -PERIOD / 1e6 * (k >= 200)), ratio=ratio).run(400)
    assert score.wrong == [] and score.relock(200) <= 8 and score.share(210) == 0
