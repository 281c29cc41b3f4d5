"""Words of the rig's memory into changes of pins, in the rig's ticks since the mark."""

from collections.abc import Sequence

from annulus_pipe.selftest.rig.board import EdgeIn
from annulus_pipe.selftest.rig.wire import FALL_DEAD, GAP_MIN, LIST_FIRST_PIN, RISE_DEAD, SAMPLED_AT, TRACK_AT

GAP_MAX = GAP_MIN + 2**18 - 1
FIRST_LOOK = TRACK_AT + 1  # a rise reported there is no change: the pin was high


def track(words: Sequence[int], odd: bool) -> list[tuple[int, int]]:
    """(tick, level) at which the track saw each change; it looks in every other tick, and took the pin to be low."""
    changes, dead, is_high = [], 0, False
    for word in words:
        turns = 0xFFFFFFFF - word
        is_high = not is_high
        changes.append((TRACK_AT + odd + 2 * (turns - 1) + dead, int(is_high)))
        dead += RISE_DEAD if is_high else FALL_DEAD
    return changes


def merged(even: Sequence[tuple[int, int]], odd: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Two tracks of one pin as one: a change that both saw is at the earlier time, one that only one saw is kept."""
    changes: list[tuple[int, int]] = []
    i = j = 0
    while i < len(even) or j < len(odd):
        if i < len(even) and j < len(odd) and even[i][1] == odd[j][1] and abs(even[i][0] - odd[j][0]) <= FALL_DEAD + 2:
            changes.append((min(even[i][0], odd[j][0]), even[i][1]))
            i, j = i + 1, j + 1
        elif j == len(odd) or (i < len(even) and even[i][0] < odd[j][0]):
            changes.append(even[i])
            i += 1
        else:
            changes.append(odd[j])
            j += 1
    return changes[1:] if changes and changes[0][0] <= FIRST_LOOK else changes


def samples(words: Sequence[int], first_pin: int, delay: int) -> list[EdgeIn]:
    """Changes of four pins within the samples; the earliest sample of a word is in its highest bits."""
    levels = [(word >> shift) & 15 for word in words for shift in range(28, -1, -4)]
    begin = SAMPLED_AT + delay
    found: list[EdgeIn] = []
    for i in range(1, len(levels)):
        changed = levels[i] ^ levels[i - 1]
        found += [(begin + i, first_pin + bit, (levels[i] >> bit) & 1) for bit in range(4) if (changed >> bit) & 1]
    return found


def play_list(edges: Sequence[tuple[int, int, int]], levels: int, begins: int) -> tuple[list[int], list[int]]:
    """Words for the player, and the tick at which each edge is then played; `begins`: of the first word.

    Edges of one tick are one word. Edges nearer than the player can go are moved apart: the ticks tell.
    """
    moments: list[tuple[int, list[tuple[int, int]]]] = []
    played = []
    for tick, pin, level in sorted(edges):
        if moments and tick <= moments[-1][0]:
            moments[-1][1].append((pin, level))
        else:
            earliest = moments[-1][0] + GAP_MIN if moments else begins + GAP_MIN
            moments.append((max(tick, earliest), [(pin, level)]))
        played.append(moments[-1][0])
    words, at = [], begins
    for tick, changes in moments:
        words += _hold(levels, tick - at)
        for pin, level in changes:
            levels = (levels & ~(1 << pin)) | (level << pin)
        at = tick
    words += _hold(levels, GAP_MIN)
    return words, played


def _hold(levels: int, ticks: int) -> list[int]:
    """These levels for so long: one word, or several."""
    words = []
    while ticks > 0:
        gap = ticks if ticks <= GAP_MAX else min(GAP_MAX, ticks - GAP_MIN)
        words.append((levels >> LIST_FIRST_PIN) | ((gap - GAP_MIN) << 14))
        ticks -= gap
    return words
