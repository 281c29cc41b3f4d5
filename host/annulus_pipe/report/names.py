"""What things are called and coloured in a report, in its pictures as in its words. Draws nothing."""

import numpy as np

INK, FAINT, UNSEEN, HIDDEN = "#1c2733", "#6b7885", "#c9ced4", "#59626c"
LOSS_RED, BUMP_BLUE, FEATURE, OBSERVED = "#b3261e", "#1d5fa8", "#4b2e83", "#0b6170"
EXAGGERATION = 3.0  # of the deviation in the views of both halves; their captions say so


def round_up(value: float) -> float:
    """The next round number."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-6)))
    return float(next(step * power for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= value * 0.999))


def letter(number: int) -> str:
    """A, B .. Z, AA, AB ..: the name of the number-th feature, from 0."""
    return (letter(number // 26 - 1) if number >= 26 else "") + chr(ord("A") + number % 26)


def question(number: int) -> str:
    """?1, ?2 ..: the name of the number-th place that could not be decided, from 0."""
    return f"?{number + 1}"


def marked(number: int) -> str:
    """M1, M2 ..: the name of the number-th thing that an operator marked, from 0."""
    return f"M{number + 1}"
