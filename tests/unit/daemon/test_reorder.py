"""Promises about the order of profiles."""

import random

from annulus_pipe.daemon.reorder import ReorderBuffer


def test_whatever_the_order_of_answers_they_come_out_in_the_order_of_frames() -> None:
    for seed in range(50):
        rng, order, out = random.Random(seed), ReorderBuffer[int](), []
        asked, pending = iter(range(0, 300, 3)), []
        for _ in range(400):
            if rng.random() < 0.5 and (number := next(asked, None)) is not None:
                order.expect(number)
                pending.append(number)
            elif pending:
                number = pending.pop(rng.randrange(len(pending)))
                order.came(number, None if rng.random() < 0.2 else number)
            out += order.ready()
        for number in pending[1:]:
            order.came(number, number)
        out += order.ready(final=True)
        assert [number for number, _ in out] == list(range(0, 300, 3))
        assert all(answer in (None, number) for number, answer in out)
        assert pending == [] or (pending[0], None) in out
