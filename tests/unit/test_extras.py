"""What an extra brings is asked for where its work begins, and a machine without it is told what adds it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from annulus_pipe import extras
from annulus_pipe.extras import EXTRA_OF, adds, need, requirements
from annulus_pipe.vocabulary import AnnulusError

ROOT = Path(__file__).resolve().parents[2]
IMPORTED = {
    "scikit-fem": "skfem",
    "pyvisa-py": "pyvisa_py",
    "foxglove-sdk": "foxglove",
}  # as; by their own names otherwise
BLOCKED = f"""
import sys
class Nobody:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {set(EXTRA_OF)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Nobody())
"""


def without_extras(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", BLOCKED + code, *arguments], capture_output=True, text=True, cwd=ROOT, check=False
    )


def test_every_package_of_an_extra_is_known_by_the_name_that_is_imported() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    brought: dict[str, set[str]] = {}
    for extra, lines in listed.items():
        for line in lines:
            name, inner = re.match(r"([\w-]+)(?:\[([\w-]+)\])?", line).groups()  # type: ignore[union-attr]
            for one in (name, inner):
                if one and extra != "pi":  # simplejpeg is imported by picamera2, never here
                    brought.setdefault(IMPORTED.get(one, one), set()).add(extra)
    named = {package: extra for package, extra in EXTRA_OF.items() if extra != "pi"}
    assert brought.keys() == named.keys()
    assert all(extra in brought[package] for package, extra in named.items())


def test_every_room_and_command_is_imported_without_any_extra() -> None:
    rooms = """
import importlib, pkgutil, annulus_pipe
for found in pkgutil.walk_packages(annulus_pipe.__path__, "annulus_pipe."):
    if not found.name.startswith("annulus_pipe.shipped."):  # a library, no module
        importlib.import_module(found.name)
print("all")
"""
    run = without_extras(rooms)
    assert run.returncode == 0, run.stderr[-2000:]
    assert run.stdout.startswith("all")


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    "command",
    [["--help"], ["reconstruct", "--help"], ["demo", "--help"], ["daemon", "--config", "none.toml", "--check"]],
)
def test_what_a_field_machine_does_needs_no_extra(command: list[str]) -> None:
    run = without_extras("from annulus_pipe.cli import main\nmain()", *command)
    assert "is not installed" not in run.stdout + run.stderr
    assert "Traceback" not in run.stderr
    assert run.returncode == ("--check" in command)


@pytest.mark.deep(
    gate="tests/unit/test_extras.py::test_one_that_does_not_load_is_told_apart_from_one_that_is_not_there"
)
def test_work_that_needs_one_says_which_and_how_to_add_it(tmp_path: Path) -> None:
    (tmp_path / "raw.hdf5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    code = "from annulus_pipe.cli import main\nmain()"
    image = without_extras(code, "tai", "image", str(tmp_path / "raw.hdf5"), "-o", str(tmp_path / "out"))
    model = without_extras(code, "bore", "model", "-o", str(tmp_path / "model"))
    for run, package, extra in ((image, "h5py", "tai"), (model, "skfem", "crossbore")):
        said = f'annulus: {package} is not installed: it is part of the extra "{extra}". make setup EXTRAS={extra}\n'
        assert (run.returncode, run.stderr) == (1, said)


def test_the_command_is_the_one_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert adds("tai") == "make setup EXTRAS=tai"
    monkeypatch.setattr(extras, "is_shipped", lambda _: True)  # a wheel
    assert adds("tai", tmp_path) == f"{tmp_path}/bin/pip install 'annulus-pipe[tai]'"
    (tmp_path / "pipx_metadata.json").write_text("{}")
    assert adds("tai", tmp_path).startswith("pipx inject annulus-pipe 'cvxpy>=")
    assert {one.partition(">")[0] for one in requirements("tai")} == {"cvxpy", "h5py", "pyvisa", "pyvisa-py"}


def test_one_that_does_not_load_is_told_apart_from_one_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ezdxf.py").write_text("raise OSError('cannot load library libnothing.so:\\n no such file')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "ezdxf", raising=False)
    with pytest.raises(AnnulusError, match=r"^ezdxf is installed, and does not load: cannot load library libnothing"):
        need("ezdxf")
