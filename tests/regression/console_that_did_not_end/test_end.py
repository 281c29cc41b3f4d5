"""A console that was told to end just as a reconstruction's child ended forgot it, and waited for ever."""

import asyncio
import os

import pytest

from annulus_pipe.console import reconstructing


class Child:
    """Ends when it is let."""

    pid = 1 << 22

    def __init__(self) -> None:
        self.ended = asyncio.get_running_loop().create_future()

    @property
    def returncode(self) -> int | None:
        return int(self.ended.result()) if self.ended.done() else None

    async def wait(self) -> int:
        return int(await self.ended)


@pytest.mark.parametrize("turns", range(6))
def test_who_is_told_to_end_as_its_child_ends_does(monkeypatch: pytest.MonkeyPatch, turns: int) -> None:
    monkeypatch.setattr(os, "killpg", lambda group, by: None)

    async def one_after_the_other(child: Child) -> None:
        await reconstructing._end_group(child)  # type: ignore[arg-type]
        await asyncio.Event().wait()  # for the next one

    async def ends() -> bool:
        child = Child()
        work = asyncio.create_task(one_after_the_other(child))
        for _ in range(3):
            await asyncio.sleep(0)
        child.ended.set_result(0)
        for _ in range(turns):  # of the loop, between the child's end and the word
            await asyncio.sleep(0)
        work.cancel()
        await asyncio.wait([work], timeout=0.5)
        return work.cancelled()

    assert asyncio.run(ends())
