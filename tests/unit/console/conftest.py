"""A console in front of a daemon that only talks, and browsers for it."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from browsing import ORIGIN, Browser, running
from fake_daemon import FakeDaemon

from annulus_pipe.console.access import Password
from annulus_pipe.console.program import Daemon, Door, Program
from annulus_pipe.console.web import application

with warnings.catch_warnings():  # it would rather have httpx2
    warnings.simplefilter("ignore")
    from starlette.testclient import TestClient


@pytest.fixture
def head() -> Iterator[FakeDaemon]:
    with FakeDaemon() as one:
        yield one


@pytest.fixture
def program(head: FakeDaemon) -> Iterator[Program]:
    yield Program(Daemon(head.publish, head.control), Door())


@pytest.fixture
def console(program: Program) -> Iterator[Browser]:
    """On loopback, nobody logs in; the browser has a session."""
    with TestClient(application(program), base_url=ORIGIN) as client:
        browser = Browser(client)
        browser.session()
        yield browser


@pytest.fixture
def locked(head: FakeDaemon, tmp_path: Path) -> Iterator[tuple[Browser, str]]:
    """As reached from outside, and its password."""
    password = Password(tmp_path / "state/password.json")
    word = password.made()
    origin = "https://head.example:8600"
    door = Door(
        "0.0.0.0", tls_cert=Path("cert.pem"), tls_key=Path("key.pem"), names=("head.example",), password=password
    )
    program = Program(Daemon(head.publish, head.control), door)
    with TestClient(application(program), base_url=origin) as client:
        browser = Browser(client, origin=origin)
        browser.session()
        yield browser, word


@pytest.fixture
def served(program: Program) -> Iterator[str]:
    """The same by uvicorn, as people have it. Its address, host:port."""
    program.door = Door(port=0)
    with running(program) as address:
        yield address
