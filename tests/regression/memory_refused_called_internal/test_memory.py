"""A command that was refused memory called it an internal error to be reported, with status 70."""

import errno
import os

import pytest

from annulus_pipe.cli import app as command

SAID = [
    MemoryError(),
    MemoryError("Unable to allocate 8.00 TiB for an array"),
    OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
    RuntimeError("can't start new thread"),
    ImportError("libx.so: failed to map segment from shared object: Cannot allocate memory"),
]


@pytest.mark.parametrize("error", SAID, ids=lambda error: type(error).__name__)
def test_a_lack_of_memory_is_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused() -> None:
        raise error

    monkeypatch.setattr(command, "app", refused)
    with pytest.raises(SystemExit) as ended:
        command.main()
    told = capsys.readouterr().err
    assert ended.value.code == 1 and told.startswith("annulus: not enough memory (") and told.count("\n") == 1


def test_anything_else_is_still_ours(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for error in (RuntimeError("a bug"), OSError(errno.ENOENT, "gone"), ImportError("no module")):
        monkeypatch.setattr(command, "app", lambda error=error: (_ for _ in ()).throw(error))
        with pytest.raises(SystemExit) as ended:
            command.main()
        assert ended.value.code == 70 and "internal error" in capsys.readouterr().err
