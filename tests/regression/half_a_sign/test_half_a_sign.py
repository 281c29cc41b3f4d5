"""Half a surrogate pair in a mark, which JSON may say, was 504: the console found at the socket that it cannot be
packed, and called it an answer of the daemon's that cannot be read."""

import asyncio
import json
from typing import Any

import pytest
import zmq

from annulus_pipe.console.answers import Refusal, asked_for
from annulus_pipe.console.viewing import parse
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.vocabulary import AnnulusError

HALF = "joint \ud800"


@pytest.mark.parametrize(
    "said", [{"text": HALF}, {HALF: 1}, {"job": {"site": ["\udfff"]}}, {"do": HALF}], ids=["text", "name", "deep", "do"]
)
def test_the_console_refuses_it_at_once(said: Any) -> None:
    class Request:
        async def body(self) -> bytes:
            return json.dumps(said).encode()

    with pytest.raises(Refusal, match="half a sign") as refused:
        asyncio.run(asked_for(Request()))  # type: ignore[arg-type]
    assert refused.value.status == 400
    with pytest.raises(ValueError, match="half a sign"):
        parse(json.dumps(said))


def test_whole_signs_pass() -> None:
    class Request:
        async def body(self) -> bytes:
            return b'{"text": "\\ud83d\\ude00 \xc3\xa4 \\\\ud800"}'

    assert asyncio.run(asked_for(Request()))["text"] == "\U0001f600 ä \\ud800"  # type: ignore[arg-type]


def test_a_program_that_says_it_is_told_at_once() -> None:
    with zmq.Context() as context, context.socket(zmq.ROUTER) as socket:
        port = socket.bind_to_random_port("tcp://127.0.0.1")
        with ControlClient(f"tcp://127.0.0.1:{port}") as head, pytest.raises(AnnulusError, match="half a sign"):
            head.mark(HALF)
