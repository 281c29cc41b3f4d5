"""What was tried against the page's program, and what happened."""

import json
import time
from types import SimpleNamespace
from typing import Any

import pytest
from browsing import ORIGIN, Browser
from fake_daemon import FakeDaemon
from starlette.websockets import WebSocketDisconnect

from annulus_pipe.console import gate, web
from annulus_pipe.console.gate import FILES_POLICY, POLICY

PATHS = [
    "/static/../web.py",
    "/static/..%2fweb.py",
    "/static/%2e%2e/web.py",
    "/static/..\\web.py",
    "/static//etc/passwd",
    "/static/%2fetc%2fpasswd",
    "/static/....//web.py",
    "/static/%00",
    "/static/strings/../../web.py",
    "/.git",
    "/api/surveys/file/../../etc/passwd",
    "/api/defect/7/..",
    "/api/frame/0/-1",
    "/api/frame/0/99999999999999999999",
]


def error_of(answer: Any, status: int) -> str:
    assert answer.status_code == status, answer.text
    body = answer.json()
    assert body["ok"] is False and "\n" not in body["error"] and 3 < len(body["error"]) <= 500
    return str(body["error"])


def did(head: FakeDaemon) -> list[str]:
    """What it was asked that changes something."""
    return [asked["do"] for asked in head.asked if asked["do"] not in ("about", "state")]


def test_a_page_of_another_site_can_ask_nothing(console: Browser, head: FakeDaemon) -> None:
    """Its browser sends this console's cookie along where SameSite does not keep it, and its own origin."""
    for origin in ("http://evil.example", "null", "http://127.0.0.1:9999", "https://127.0.0.1:8600", "-"):
        assert "Origin" in error_of(console.post("/api/do", {"do": "stop"}, Origin=origin), 403)
    assert did(head) == []


def test_a_form_of_another_site_is_no_request(console: Browser, head: FakeDaemon) -> None:
    for kind in ("application/x-www-form-urlencoded", "text/plain", "multipart/form-data; boundary=x", "-"):
        error_of(console.post("/api/do", '{"do": "stop"}', **{"Content-Type": kind}), 400)
    assert did(head) == []


def test_without_the_token_nothing_is_done(console: Browser, head: FakeDaemon) -> None:
    for token in ("-", "", "guess", console.token[:-1], console.token + "x"):
        assert "Token" in error_of(console.post("/api/do", {"do": "stop"}, **{"X-Annulus-Token": token}), 403)
    assert did(head) == []


def test_without_a_cookie_nothing_is_done(console: Browser, head: FakeDaemon) -> None:
    console.client.cookies.clear()
    assert "cookie" in error_of(console.do("stop"), 401)
    console.client.cookies.set("annulus-8600", "guess")
    error_of(console.do("stop"), 401)
    assert did(head) == []


def test_a_name_resolved_to_this_machine_is_no_name_of_ours(console: Browser, head: FakeDaemon) -> None:
    """DNS rebinding: the browser takes the page's origin for its own, and says it as Host."""
    for host in ("evil.example:8600", "evil.example", "", "127.0.0.1.evil.example"):
        for path in ("/", "/api/session", "/api/surveys", "/static/index.html"):
            assert "Host" in error_of(console.client.get(path, headers={"Host": host}), 403)
        error_of(console.post("/api/do", {"do": "stop"}, Host=host, Origin=f"http://{host}"), 403)
    assert did(head) == []


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "http://evil.example"}, {"Origin": "-"}, {"Origin": "null"}, {"Host": "evil.example:8600"}],
    ids=["foreign", "none", "null", "host"],
)
def test_a_websocket_of_another_site_is_refused(console: Browser, headers: dict[str, str]) -> None:
    with pytest.raises(Exception) as caught, console.view(**headers):
        pass
    assert getattr(caught.value, "status_code", None) == 403


def test_every_answer_says_what_a_page_may(console: Browser) -> None:
    for path in ("/", "/static/index.html", "/api/session", "/nothing", "/api/frame/0/0"):
        headers = console.client.get(path).headers
        assert headers["content-security-policy"] == POLICY
        assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
        assert "server" not in headers
    assert "unsafe" not in POLICY and "*" not in POLICY
    report = console.client.get("/api/surveys/file/1/report.html").headers["content-security-policy"]
    assert report == FILES_POLICY and "allow-same-origin" not in report and "default-src 'none'" in report


def test_the_cookie_is_kept_from_scripts_and_other_sites(console: Browser, locked: tuple[Browser, str]) -> None:
    console.client.cookies.clear()
    plain = console.client.get("/api/session").headers["set-cookie"].lower()
    assert "httponly" in plain and "samesite=strict" in plain and "secure" not in plain and "domain" not in plain
    locked[0].client.cookies.clear()
    tls = locked[0].client.get("/api/session").headers["set-cookie"]
    assert tls.startswith("__Host-") and "; secure" in tls.lower() and "path=/" in tls.lower()


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("path", PATHS)
def test_no_path_leads_out(path: str, console: Browser) -> None:
    answer = console.client.get(path)
    assert answer.status_code in (400, 404)
    assert b"root:" not in answer.content and b"import" not in answer.content


def test_a_path_of_a_thousand_characters_is_none(console: Browser) -> None:
    error_of(console.client.get("/static/" + "a" * 1000), 404)


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"])
def test_other_methods_are_refused(method: str, console: Browser) -> None:
    error_of(console.client.request(method, "/api/session"), 405)


def test_asking_with_get_changes_nothing(console: Browser, head: FakeDaemon) -> None:
    for path in ("/api/do", "/api/arm", "/api/login", "/api/logout"):
        error_of(console.client.get(path), 405)
    assert did(head) == []


MALFORMED = [
    b"",
    b"{",
    b"[]",
    b"5",
    b'"do"',
    b"\xff\xfe",
    b'{"do": 1}',
    b'{"do": null}',
    b"{}",
    b'{"do": "stop", "do": "start"}',
    b'{"do": NaN}',
    b"[" * 50_000,
    b'{"do": "stop", "x": ' + b"9" * 20_000 + b"}",
]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("body", MALFORMED, ids=lambda body: body[:12].decode("latin-1"))
def test_what_is_no_request_is_answered_in_a_line(body: bytes, console: Browser, head: FakeDaemon) -> None:
    error_of(console.post("/api/do", body), 400)
    assert did(head) == []


def test_a_large_request_is_not_taken_in(console: Browser, head: FakeDaemon) -> None:
    assert "96 KiB" in error_of(console.post("/api/do", b" " * (97 << 10)), 413)
    assert "96 KiB" in error_of(console.post("/api/do", b"{}", **{"Content-Length": "99999999999999999999"}), 413)

    def endless() -> Any:
        for _ in range(200):
            yield b" " * 1024

    usual = {"Origin": ORIGIN, "X-Annulus-Token": console.token, "Content-Type": "application/json"}
    assert "96 KiB" in error_of(console.client.post("/api/do", content=endless(), headers=usual), 413)
    assert did(head) == []


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What the routes take for the time, s: it stands still."""
    now = [time.monotonic()]
    for room in (gate, web):
        monkeypatch.setattr(room, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_who_asks_too_often_is_told_so(console: Browser, head: FakeDaemon, clock: list[float]) -> None:
    clock[0] += 10.0
    assert [console.post("/api/arm").status_code for _ in range(60)] == [200] * 40 + [429] * 20
    clock[0] += 0.501
    assert [console.post("/api/arm").status_code for _ in range(20)] == [200] * 10 + [429] * 10
    assert did(head) == []


def test_lamps_come_on_after_a_second_step_only(console: Browser, head: FakeDaemon) -> None:
    for confirm in ({}, {"confirm": "guess"}, {"confirm": None}, {"confirm": 5}):
        assert "second step" in error_of(console.do("start", **confirm), 403)
        assert "second step" in error_of(console.do("resume", **confirm), 403)
    assert did(head) == []
    word = console.post("/api/arm").json()["confirm"]
    assert console.do("start", confirm=word).json()["state"] == "scanning"
    assert console.do("stop").json()["ok"]
    error_of(console.do("start", confirm=word), 403)  # once
    assert did(head) == ["start", "stop"]
    assert "confirm" not in head.asked[-1]


def test_a_browser_cannot_say_that_it_is_another(console: Browser, head: FakeDaemon) -> None:
    mine = console.session()["id"]
    console.do("command", who={"id": "another", "name": "the chief"})
    (who,) = [asked["who"] for asked in head.asked if asked["do"] == "command"]
    assert (who["name"], who["from"]) == (f"browser {mine[:4]}", "testclient")
    assert who["id"] not in ("another", mine) and who["id"] not in console.client.get("/api/session").text


def test_a_script_in_a_name_stays_a_text(console: Browser, head: FakeDaemon) -> None:
    script = "<script>alert(1)</script>"
    console.post("/api/login", {"name": script})
    console.do("command")
    console.do("job", job={"client": script})
    answer = console.client.get("/api/session")
    assert answer.json()["name"] == script and answer.headers["content-type"] == "application/json"
    assert head.asked[-1]["who"]["name"] == script
    with console.view() as socket:
        assert json.loads(socket.receive_bytes()[1:])["topic"] == "hello"


SAID = [
    "",
    "{",
    "[]",
    "null",
    '{"want": "points"}',
    '{"want": ["all"]}',
    '{"hidden": 1}',
    '{"do": "start"}',
    '{"want": [{}]}',
    "[" * 400,
    b"\x00\x01",
]


@pytest.mark.parametrize("said", SAID, ids=lambda said: str(said)[:20])
def test_a_viewer_that_says_nonsense_is_shown_out(said: str | bytes, console: Browser) -> None:
    with console.view() as socket:
        (socket.send_bytes if isinstance(said, bytes) else socket.send_text)(said)  # type: ignore[operator]
        assert closed(socket) == 1008


def test_a_viewer_that_says_too_much_is_shown_out(console: Browser) -> None:
    with console.view() as socket:
        for _ in range(100):
            socket.send_text('{"here": true}')
        assert closed(socket) == 1008


def closed(socket: Any) -> int:
    """What the connection was ended with."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        try:
            socket.receive_bytes()
        except WebSocketDisconnect as ended:
            return ended.code
    raise AssertionError("not within 30 s")


def test_a_photograph_is_a_jpeg_or_nothing(console: Browser, head: FakeDaemon) -> None:
    for wrong in (5, "###", "aGVsbG8=", "data:text/html;base64,aGVsbG8="):
        assert "JPEG" in error_of(console.do("mark", text="joint", photo=wrong), 400)
    assert console.do("mark", text="joint", photo="data:image/jpeg;base64,/9j/4AAQ").json()["ok"]
    assert head.asked[-1]["photo"] == b"\xff\xd8\xff\xe0\x00\x10"


def test_from_outside_nothing_but_the_door_is_shown(locked: tuple[Browser, str], head: FakeDaemon) -> None:
    browser, _ = locked
    assert browser.session()["needs_login"] is True
    assert browser.client.get("/").status_code == browser.client.get("/static/index.html").status_code == 200
    for path in ("/api/frame/0/0", "/api/defect/7/0", "/api/surveys", "/api/nothing", "/other"):
        assert error_of(browser.client.get(path), 401) == "log in first"
    for path in ("/api/do", "/api/arm", "/api/logout", "/api/tune"):
        error_of(browser.post(path, {"do": "stop"}), 401)
    with pytest.raises(Exception) as caught, browser.view():
        pass
    assert getattr(caught.value, "status_code", None) == 401
    assert did(head) == []


def test_who_logs_in_is_let_in_with_another_cookie_and_who_logs_out_is_not(locked: tuple[Browser, str]) -> None:
    browser, word = locked
    before = dict(browser.client.cookies), browser.token
    assert error_of(browser.post("/api/login", {"password": "guess"}), 401) == "the password is wrong"
    told = browser.post("/api/login", {"password": word, "name": "J. Doe"}).json()
    assert (told["ok"], told["name"], told["needs_login"]) == (True, "J. Doe", False)
    assert dict(browser.client.cookies) != before[0] and told["token"] != before[1]
    error_of(browser.do("state"), 403)  # the token of before
    browser.token = told["token"]
    assert browser.do("state").json()["ok"]
    stolen = dict(browser.client.cookies)
    assert browser.post("/api/logout").json()["ok"]
    browser.client.cookies.clear()
    browser.client.cookies.update(stolen)
    error_of(browser.do("state"), 401)


def test_a_password_is_not_guessed_by_trying(locked: tuple[Browser, str], clock: list[float]) -> None:
    browser, word = locked
    answers = [browser.post("/api/login", {"password": f"guess-{number}"}).status_code for number in range(10)]
    assert answers == [401] * 5 + [429] * 5
    assert browser.post("/api/login", {"password": word}).status_code == 429  # nor by the right one, for a while


def test_a_cookie_made_before_login_is_worth_nothing_after(locked: tuple[Browser, str]) -> None:
    """Session fixation: a cookie that somebody else knows must not become one that is let in."""
    browser, word = locked
    planted = dict(browser.client.cookies)
    browser.post("/api/login", {"password": word})
    browser.client.cookies.clear()
    browser.client.cookies.update(planted)
    error_of(browser.client.get("/api/surveys"), 401)
