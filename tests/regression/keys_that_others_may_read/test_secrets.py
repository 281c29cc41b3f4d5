"""CURVE secret keys of mode 666, or of another user, were taken without a word; only the password was looked at."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import zmq

from annulus_pipe.console.access import Password, client_keys
from annulus_pipe.console.program import Daemon, Door, Program
from annulus_pipe.console.serving import prepared
from annulus_pipe.daemon.config import load_config
from annulus_pipe.doctor.machine import secrets
from annulus_pipe.vocabulary import AnnulusError

PUBLIC, SECRET = (key.decode() for key in zmq.curve_keypair())


def of_head_toml(key: Path) -> None:
    head = key.with_name("head.toml")
    head.write_text(f'[camera]\nkind = "folder"\ndevice = "."\n[publish]\nkey_file = "{key.name}"\n')
    load_config(head)


def of_the_console(key: Path) -> None:
    client_keys(key, PUBLIC)


def of_its_page(key: Path) -> None:
    door = Door(port=0, tls_cert=key, tls_key=key)
    with Program(Daemon("tcp://127.0.0.1:5701", "tcp://127.0.0.1:5702"), door) as program:
        prepared(program)


def of_its_password(key: Path) -> None:
    Password(key).check("word")


READERS = [of_head_toml, of_the_console, of_its_page, of_its_password]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("mode", [0o666, 0o640, 0o620, 0o604])
def test_a_secret_that_others_may_read_or_change_is_refused_in_a_line(
    tmp_path: Path, read: Callable[[Path], None], mode: int
) -> None:
    key = tmp_path / "a.key"
    key.write_text(SECRET)
    key.chmod(mode)
    with pytest.raises(
        AnnulusError, match=rf"a\.key: others may (read|change) it, expected mode 600 and not {mode:o}"
    ) as caught:
        read(key)
    assert "\n" not in str(caught.value) and SECRET not in str(caught.value)
    (row,) = secrets([key, tmp_path / "none"])
    assert row.ok is False and "expected mode 600" in row.text


@pytest.mark.parametrize("read", READERS)
def test_a_secret_of_another_user_is_refused(
    tmp_path: Path, read: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    key = tmp_path / "a.key"
    key.write_text(SECRET)
    key.chmod(0o600)
    mine = os.getuid()
    if mine == 0:
        os.chown(key, 7, 7)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    with pytest.raises(AnnulusError, match=r"a\.key: belongs to user"):
        read(key)


def test_a_secret_of_this_users_alone_is_read(tmp_path: Path) -> None:
    key = tmp_path / "a.key"
    key.write_text(SECRET)
    key.chmod(0o400)
    assert client_keys(key, PUBLIC).secret == SECRET
    assert [row.ok for row in secrets([key])] == [True]
