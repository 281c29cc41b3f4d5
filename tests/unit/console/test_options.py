"""`annulus console`: what it may be told, and one line where it may not."""

import json
import ssl
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq
from browsing import running
from fake_daemon import FakeDaemon
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.console import serving
from annulus_pipe.console.access import Password
from annulus_pipe.console.program import Daemon, Door, Program
from annulus_pipe.vocabulary import AnnulusError

DAEMON = "tcp://127.0.0.1:5601,tcp://127.0.0.1:5602"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[Any]]:
    """The programs that would have been served."""
    programs: list[Any] = []
    monkeypatch.setattr(serving, "serve", programs.append)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    yield programs
    for one in programs:
        one.close()


def typed(*words: str) -> str:
    """What it printed. Raises what it raised."""
    result = CliRunner().invoke(app, ["console", *words])
    if result.exception is not None:
        raise result.exception
    return result.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "expected one of --demo, --config"),
        (["--demo", "--daemon", DAEMON], "expected one of --demo, --config"),
        (["--daemon", "tcp://127.0.0.1:5601"], "expected two addresses"),
        (["--daemon", "a,b"], "expected two addresses"),
        (["--daemon", "tcp://x:y,tcp://x:z"], "expected tcp://ADDRESS:PORT"),
        (["--daemon", DAEMON, "--host", "0.0.0.0"], "needs --tls-cert and --tls-key"),
        (["--daemon", DAEMON, "--tls-cert", "a.pem"], "belong together"),
        (["--daemon", DAEMON, "--key-file", "a.key"], "goes with --daemon-key"),
        (["--daemon", DAEMON, "--daemon-key", "x" * 40], "--key-file names"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_what_does_not_go_is_said_in_a_line(words: list[str], said: str, made: list[Any]) -> None:
    with pytest.raises(AnnulusError) as caught:
        typed(*words)
    assert said in str(caught.value) and "\n" not in str(caught.value) and not made


def test_on_loopback_nobody_logs_in(made: list[Any]) -> None:
    assert "password" not in typed("--daemon", DAEMON, "--surveys", "a", "--surveys", "b")
    assert made[0].door.password is None and made[0].surveys == (Path("a"), Path("b"))


def test_a_password_is_made_once_and_another_when_asked_for(made: list[Any], tmp_path: Path) -> None:
    outside = ("--daemon", DAEMON, "--host", "0.0.0.0", "--tls-cert", "a.pem", "--tls-key", "b.pem")
    words = [line.split()[1] for line in typed(*outside).splitlines() if line.startswith("password ")]
    assert len(words) == 1 and made[0].door.password.check(words[0])
    assert not [line for line in typed(*outside).splitlines() if line.startswith("password ")]
    assert made[1].door.password.check(words[0])
    typed("--daemon", DAEMON, "--new-password")
    assert not made[2].door.password.check(words[0])
    assert (tmp_path / "state/annulus/console-password.json").is_file()


def test_a_head_toml_says_where_its_daemon_is(made: list[Any], tmp_path: Path) -> None:
    server, mine = zmq.curve_keypair(), zmq.curve_keypair()
    (tmp_path / "publish.key").write_text(server[1].decode())
    (tmp_path / "console.key").write_text(mine[1].decode())
    for name in ("publish.key", "console.key"):
        (tmp_path / name).chmod(0o600)
    sockets = (
        f'[publish]\naddress = "tcp://127.0.0.1:5701"\nkey_file = "publish.key"\nviewers = ["{mine[0].decode()}"]\n'
    )
    (tmp_path / "head.toml").write_text('[camera]\nkind = "folder"\ndevice = "."\n' + sockets)
    with pytest.raises(AnnulusError, match=r"\[control\] is missing"):
        typed("--config", str(tmp_path / "head.toml"), "--key-file", str(tmp_path / "console.key"))
    with (tmp_path / "head.toml").open("a") as file:
        file.write('[control]\naddress = "tcp://127.0.0.1:5702"\n')
    typed("--config", str(tmp_path / "head.toml"), "--key-file", str(tmp_path / "console.key"))
    assert made[0].feed.address == "tcp://127.0.0.1:5701" and made[0].commands.address == "tcp://127.0.0.1:5702"
    with pytest.raises(AnnulusError, match="--key-file names"):
        typed("--config", str(tmp_path / "head.toml"))


def test_over_tls_a_page_is_served_and_the_password_asked_for(head: FakeDaemon, tmp_path: Path) -> None:
    files = {"-keyout": "key.pem", "-out": "cert.pem"}
    words = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    try:
        subprocess.run(
            [*words, *(one for pair in files.items() for one in pair)], cwd=tmp_path, check=True, capture_output=True
        )
    except FileNotFoundError:
        pytest.skip("no openssl here")
    password = Password(tmp_path / "password.json")
    password.made()
    door = Door(port=0, tls_cert=tmp_path / "cert.pem", tls_key=tmp_path / "key.pem", password=password)
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    with running(Program(Daemon(head.publish, head.control), door)) as address:
        with urllib.request.urlopen(f"https://{address}/api/session", context=trusting) as answer:
            assert json.load(answer)["needs_login"] is True
            assert "Secure" in answer.headers["Set-Cookie"]
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(f"https://{address}/api/surveys", context=trusting)
        assert refused.value.code == 401


def test_a_certificate_that_is_none_is_said_in_a_line(head: FakeDaemon, tmp_path: Path) -> None:
    (tmp_path / "cert.pem").write_text("no certificate")
    (tmp_path / "cert.pem").chmod(0o600)
    for cert in ("cert.pem", "none.pem"):
        door = Door(port=0, tls_cert=tmp_path / cert, tls_key=tmp_path / cert)
        with (
            Program(Daemon(head.publish, head.control), door) as program,
            pytest.raises(AnnulusError, match="no certificate and its key"),
        ):
            serving.prepared(program)
