"""Requests to the daemon, and whose command is renewed: only that of a browser whose page answers."""

import asyncio
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import zmq
from browsing import Browser, status
from fake_daemon import FakeDaemon

from annulus_pipe.console import commands as commands_module
from annulus_pipe.console import program as program_module
from annulus_pipe.console import wire
from annulus_pipe.console.answers import Refusal
from annulus_pipe.console.commands import AT_ONCE, Commands, Lease
from annulus_pipe.console.program import Program
from annulus_pipe.stream.access import ClientKeys

ME, OTHER = {"id": "me", "name": "J. Doe"}, {"id": "other", "name": "A. N. Other"}


def ask(head: FakeDaemon, request: Mapping[str, Any], timeout_s: float = 30.0) -> Mapping[str, Any]:
    commands = Commands(zmq.Context.instance(), head.control)
    try:
        return asyncio.run(commands.ask(request, timeout_s))
    finally:
        commands.close()


def test_an_answer_is_the_daemons(head: FakeDaemon) -> None:
    assert ask(head, {"do": "about"})["about"]["version"] == "0.1.0"
    with pytest.raises(Refusal, match="expected one of start, stop") as refused:
        ask(head, {"do": "jump"})
    assert refused.value.status == 409


def test_a_daemon_that_says_nothing_is_no_daemon(head: FakeDaemon, stalls: Any) -> None:
    head.silent = True
    begun = time.monotonic()
    with pytest.raises(Refusal, match=r"no answer from the daemon within 0\.2 s") as refused:
        ask(head, {"do": "state"}, 0.2)
    took_s = time.monotonic() - begun
    assert refused.value.status == 504
    if stalls.since(begun) < 0.1:
        assert took_s < 2.0


def test_an_answer_that_comes_late_is_nobodys(head: FakeDaemon) -> None:
    """The next request has its own, not the one that was given up."""
    commands = Commands(zmq.Context.instance(), head.control)

    async def both() -> Mapping[str, Any]:
        head.silent = True
        with pytest.raises(Refusal):
            await commands.ask({"do": "about"}, 0.1)
        head.silent = False
        return await commands.ask({"do": "state"}, 30.0)

    assert "about" not in asyncio.run(both())
    commands.close()


def test_so_many_requests_wait_for_a_daemon_and_no_more(head: FakeDaemon) -> None:
    head.silent = True
    commands = Commands(zmq.Context.instance(), head.control)

    async def many() -> list[int]:
        asked = [commands.ask({"do": "state"}, 0.3) for _ in range(3 * AT_ONCE)]
        answers = await asyncio.gather(*asked, return_exceptions=True)
        return [one.status for one in answers if isinstance(one, Refusal)]

    found = asyncio.run(many())
    assert found.count(504) == AT_ONCE and found.count(429) == 2 * AT_ONCE
    commands.close()


@pytest.mark.parametrize("answer", [b"", b"\xc1", b"\x90", b"\x80" * 70_000], ids=["none", "byte", "list", "long"])
def test_an_answer_that_is_none_is_said_in_a_line(answer: bytes) -> None:
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.bind("tcp://127.0.0.1:*")
        commands = Commands(context, router.getsockopt_string(zmq.LAST_ENDPOINT))

        async def go() -> None:
            asked = asyncio.create_task(commands.ask({"do": "state"}, 2.0))
            who, _ = await asyncio.to_thread(router.recv_multipart)
            router.send_multipart([who, answer])
            await asked

        with pytest.raises(Refusal) as refused:
            asyncio.run(go())
        assert refused.value.status in (409, 504) and len(str(refused.value)) < 600
        commands.close()


def test_a_daemon_elsewhere_is_spoken_to_with_keys(tmp_path: Path) -> None:
    server, mine = zmq.curve_keypair(), zmq.curve_keypair()
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.curve_server, router.curve_secretkey = True, server[1]
        router.bind("tcp://127.0.0.1:*")
        address = router.getsockopt_string(zmq.LAST_ENDPOINT)
        keys = ClientKeys(server[0].decode(), mine[0].decode(), mine[1].decode())
        commands = Commands(context, address, keys)

        async def go() -> Mapping[str, Any]:
            asked = asyncio.create_task(commands.ask({"do": "state"}, 30.0))
            who, _ = await asyncio.to_thread(router.recv_multipart)
            router.send_multipart([who, b"\x81\xa2ok\xc3"])
            return await asked

        assert asyncio.run(go()) == {"ok": True}
        commands.close()


class Told:
    """A control socket that agrees, or does not."""

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.refuses: Refusal | None = None

    async def ask(self, request: Any, timeout_s: float | None = None) -> Mapping[str, Any]:
        self.asked.append(request)
        if self.refuses is not None:
            raise self.refuses
        return {"ok": True}


@pytest.fixture
def told() -> Told:
    return Told()


def renewed(told: Told, lease: Lease) -> int:
    before = len(told.asked)
    asyncio.run(lease.renew())
    return len(told.asked) - before


def test_a_command_is_renewed_while_its_page_answers(told: Told) -> None:
    there = True
    lease = Lease(told, lambda session: there and session == "me")  # type: ignore[arg-type]
    assert renewed(told, lease) == 0 and lease.holder is None
    lease.heard("command", "me", ME)
    assert renewed(told, lease) == 1 and told.asked == [{"do": "command", "who": ME}]
    there = False
    assert renewed(told, lease) == 0
    there = True
    assert renewed(told, lease) == 1
    lease.heard("release", "other", OTHER)
    assert lease.holder == "me"
    lease.heard("release", "me", ME)
    assert renewed(told, lease) == 0 and lease.holder is None


def test_what_another_took_is_not_taken_back(told: Told) -> None:
    lease = Lease(told, lambda session: True)  # type: ignore[arg-type]
    lease.heard("command", "me", ME)
    told.refuses = Refusal(409, "A. N. Other commands")
    assert renewed(told, lease) == 1 and lease.holder is None
    told.refuses = None
    assert renewed(told, lease) == 0


def test_what_lapsed_is_not_taken_again_by_itself(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    lease = Lease(told, lambda session: True)  # type: ignore[arg-type]
    lease.heard("command", "me", ME)
    told.refuses = Refusal(504, "no answer")
    assert renewed(told, lease) == 1 and lease.holder == "me"
    monkeypatch.setattr(commands_module, "COMMAND_S", -1.0)
    assert renewed(told, lease) == 0 and lease.holder is None


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program_module, "RENEW_S", 0.05)
    monkeypatch.setattr(program_module, "ANSWERS_S", 0.4)


def test_a_page_that_sleeps_lets_its_command_go(quick: None, console: Browser, head: FakeDaemon) -> None:
    def renewals() -> int:
        return sum(asked["do"] == "command" for asked in head.asked)

    with console.view() as page:
        assert console.do("command").json()["ok"]
        said: dict[str, Any] = {}
        while not said.get("you", {}).get("commands"):
            message = page.receive_bytes()
            topic, body = status(message) if message[0] == wire.STATUS else ("", {})
            if topic == "alive":
                said = dict(body)
                page.send_text('{"here": true}')
        end = time.monotonic() + 30.0
        while renewals() < 3:
            assert time.monotonic() < end
            page.send_text('{"here": true}')
            time.sleep(0.15)
        before = -1
        while renewals() != before:  # its browser is suspended: the connection stands, and says nothing
            assert time.monotonic() < end + 30.0
            before = renewals()
            time.sleep(1.0)


def test_of_two_operators_the_other_is_told_who(console: Browser, program: Program, head: FakeDaemon) -> None:
    console.post("/api/login", {"name": "J. Doe"})
    assert console.do("command").json()["ok"]
    other = Browser(console.client)
    console.client.cookies.clear()
    other.session()
    for asked in ({"do": "zero"}, {"do": "command"}, {"do": "job", "job": {}}):
        answer = other.post("/api/do", asked)
        assert (answer.status_code, answer.json()["error"]) == (409, "J. Doe commands")
    assert other.do("mark", text="joint").json()["ok"]
    assert other.do("command", take=True).json()["ok"] and other.do("zero").json()["ok"]
