"""Answers that come in any order, put back into the order of the questions."""

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class ReorderBuffer(Generic[T]):
    """Every expected number comes out once, in the order expected: with its answer, or None when there is none.

    Holds no more than is expected and not out yet; who expects bounds that.
    """

    def __init__(self) -> None:
        self._expected: deque[int] = deque()
        self._answers: dict[int, T | None] = {}

    def expect(self, number: int) -> None:
        self._expected.append(number)

    def came(self, number: int, answer: T | None) -> None:
        """The answer to `number`; None: there will be none."""
        self._answers[number] = answer

    @property
    def missing(self) -> int:
        """How many are expected and have no answer."""
        return sum(number not in self._answers for number in self._expected)

    def ready(self, final: bool = False) -> Iterator[tuple[int, T | None]]:
        """What is next in order. `final`: nothing more will come, so what is missing is None."""
        while self._expected and (final or self._expected[0] in self._answers):
            number = self._expected.popleft()
            yield number, self._answers.pop(number, None)
