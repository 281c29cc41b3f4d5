"""Who may: password, sessions, tokens, the second step, names and origins, rates."""

import os
import stat
import time
from pathlib import Path

import pytest
import zmq

from annulus_pipe.console.access import (
    CONFIRM_S,
    IDLE_S,
    SESSIONS_MAX,
    BrowserSession,
    Bucket,
    Password,
    Rates,
    RequestOrigins,
    Sessions,
    client_keys,
    is_loopback,
    named,
    split_host,
)
from annulus_pipe.vocabulary import AnnulusError


def test_a_password_is_known_by_its_hash_only(tmp_path: Path) -> None:
    password = Password(tmp_path / "state/annulus/console-password.json")
    assert not password.is_there
    word = password.made()
    assert len(word.replace("-", "")) == 16
    assert password.check(word) and not password.check(word[:-1]) and not password.check("")
    assert word not in password.path.read_text()
    assert stat.S_IMODE(password.path.stat().st_mode) == 0o600
    other = password.made()
    assert password.check(other) and not password.check(word)


@pytest.mark.parametrize("content", ["", "{}", '{"salt": 1, "hash": "x"}', "[" * 5000, '{"salt": "A", "hash": "A"}'])
def test_a_password_file_that_is_none_is_said_in_a_line(content: str, tmp_path: Path) -> None:
    path = tmp_path / "password.json"
    path.write_text(content)
    path.chmod(0o600)
    with pytest.raises(AnnulusError, match=r"no password can be read there") as caught:
        Password(path).check("word")
    assert "\n" not in str(caught.value)


def test_a_password_that_others_may_read_is_not_used(tmp_path: Path) -> None:
    password = Password(tmp_path / "password.json")
    word = password.made()
    password.path.chmod(0o644)
    with pytest.raises(AnnulusError, match="others may read it, expected mode 600"):
        password.check(word)


def test_a_password_cannot_be_kept_where_nothing_can(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AnnulusError, match="the password cannot be kept"):
        Password(tmp_path / "file/password.json").made()


def test_a_confirmation_stands_once_and_for_ten_seconds() -> None:
    session = BrowserSession(True, 0.0)
    word = session.arm(100.0)
    assert session.confirm(word, 100.0 + CONFIRM_S) and not session.confirm(word, 100.0)
    late = session.arm(100.0)
    assert not session.confirm(late, 100.1 + CONFIRM_S)
    assert not any(session.confirm(one, 100.0) for one in (None, "", 5, ["x"], word))
    words = [session.arm(200.0) for _ in range(1000)]
    assert len(session.confirms) <= 8 and session.confirm(words[-1], 200.0)
    assert not BrowserSession(True, 0.0).confirm(words[-2], 200.0)  # another's


def test_sessions_are_bounded_and_who_is_connected_stays() -> None:
    sessions = Sessions(needs_login=True)
    connected = sessions.begin(0.0)
    sessions.in_use = lambda session: session is connected
    last = [sessions.begin(float(number)) for number in range(2 * SESSIONS_MAX)][-1]
    assert len(sessions) == SESSIONS_MAX
    assert sessions.of(connected.cookie, 1e3) is connected and sessions.of(last.cookie, 1e3) is last
    assert not last.allowed
    assert sessions.of(last.cookie, 1e3 + IDLE_S + 1) is None
    assert sessions.of(connected.cookie, 1e3 + IDLE_S + 1) is connected
    for none in (None, "", "guess", last.id, last.token):
        assert sessions.of(none, 0.0) is None
    sessions.end(connected)
    assert sessions.of(connected.cookie, 0.0) is None


def test_when_all_sessions_are_connected_no_more_begin() -> None:
    sessions = Sessions(needs_login=False)
    sessions.in_use = lambda session: True
    for _ in range(SESSIONS_MAX):
        sessions.begin(0.0)
    with pytest.raises(AnnulusError, match="256 browsers are connected"):
        sessions.begin(0.0)


def test_what_a_session_has_is_its_own() -> None:
    one, other = BrowserSession(True, 0.0), BrowserSession(True, 0.0)
    secrets = {one.id, one.cookie, one.token, other.id, other.cookie, other.token}
    assert len(secrets) == 6 and len(one.cookie) >= 43 and len(one.id) <= 40
    assert one.is_token(one.token) and not one.is_token(other.token) and not one.is_token("")


LOOPBACK = ["127.0.0.1:8600", "localhost:8600", "LocalHost", "[::1]:8600", "localhost:9000"]
ELSEWHERE = ["evil.example", "evil.example:8600", "127.0.0.1.evil.example", "localhost.evil.example", "10.0.0.5:8600"]
NONE = [
    "",
    ":8600",
    "localhost:",
    "localhost:x",
    "localhost:8600:1",
    "localhost:99999",
    "[::1",
    "[::1]x",
    "a b",
    "127.1",
]


def test_on_loopback_only_loopbacks_names_are_ours() -> None:
    places = RequestOrigins("127.0.0.1", tls=False)
    assert all(places.is_ours(host) for host in LOOPBACK)
    assert not any(places.is_ours(host) for host in ELSEWHERE + NONE)


def test_from_outside_this_machines_names_and_plain_addresses_are_ours() -> None:
    """A name that somebody else can have resolved to us is not: that is how DNS rebinding begins."""
    places = RequestOrigins("0.0.0.0", tls=True, names=["head.example"])
    assert all(
        places.is_ours(host) for host in ["head.example:8600", "HEAD.example", "10.0.0.5:8600", "[fe80::1]:8600"]
    )
    assert not any(places.is_ours(host) for host in ["evil.example", "head.example.evil.example", *NONE])


def test_an_origin_is_this_pages_own() -> None:
    places = RequestOrigins("127.0.0.1", tls=False)
    assert places.is_same("http://localhost:8600", "localhost:8600")
    for origin in (
        "null",
        "http://localhost:8601",
        "https://localhost:8600",
        "http://evil.example",
        "",
        "http://localhost",
    ):
        assert not places.is_same(origin, "localhost:8600")


def test_hosts_are_taken_apart() -> None:
    assert split_host("[::1]:8600") == ("::1", "8600")
    assert split_host("a:1") == ("a", "1") and split_host("a") == ("a", "")
    assert [is_loopback(host) for host in ("127.8.8.8", "::1", "localhost", "0.0.0.0", "::", "10.0.0.1", "x")] == [
        True,
        True,
        True,
        False,
        False,
        False,
        False,
    ]


def test_so_many_at_once_and_then_so_many_a_second() -> None:
    bucket = Bucket(10.0, 5.0, 0.0)
    assert [bucket.take(0.0) for _ in range(7)] == [True] * 5 + [False] * 2
    assert sum(bucket.take(number / 100) for number in range(1, 1001)) == pytest.approx(100, abs=5)


def test_who_asks_too_often_costs_others_nothing_and_memory_is_bounded() -> None:
    rates = Rates((1.0, 2.0))
    assert [rates.take("a", 0.0) for _ in range(3)] == [True, True, False]
    assert rates.take("b", 0.0)
    begun = time.process_time()
    for number in range(20_000):
        rates.take(f"10.0.{number}", 0.0)
    assert len(rates._buckets) <= 1000
    assert time.process_time() - begun < 1.0


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("  J.  Doe ", "J. Doe"),
        ("<script>alert(1)</script>", "<script>alert(1)</script>"),  # a text, and shown as one
        ("a\nb\tc", "a b c"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("", ""),
        ("Müller", "Müller"),
        ("abc\u202edef", "abc\\u202edef"),
    ],
)
def test_a_name_is_one_line_that_a_terminal_may_be_shown(given: str, shown: str) -> None:
    assert named(given) == shown


@pytest.mark.parametrize("wrong", [None, 5, "x" * 61, ["a"]])
def test_a_name_is_a_text_of_at_most_60_characters(wrong: object) -> None:
    with pytest.raises(ValueError, match="name must be a text of at most 60"):
        named(wrong)


def test_keys_of_a_daemon_elsewhere(tmp_path: Path) -> None:
    server, _ = (key.decode() for key in zmq.curve_keypair())
    public, secret = (key.decode() for key in zmq.curve_keypair())
    (tmp_path / "console.key").write_text(secret + "\n")
    (tmp_path / "console.key").chmod(0o600)
    keys = client_keys(tmp_path / "console.key", server)
    assert (keys.server, keys.public, keys.secret) == (server, public, secret)
    with pytest.raises(AnnulusError, match="no public CURVE key"):
        client_keys(tmp_path / "console.key", "x" * 40 + "\n")
    (tmp_path / "bad.key").write_text("secret")
    (tmp_path / "bad.key").chmod(0o600)
    with pytest.raises(AnnulusError, match="not a CURVE secret key"):
        client_keys(tmp_path / "bad.key", server)
    with pytest.raises(AnnulusError, match="cannot be read"):
        client_keys(tmp_path / "none.key", server)
    assert os.listdir(tmp_path)
