"""Doors to the loops in C: their declarations are the C's own, and no call reaches memory that is not as declared."""

import importlib
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import annulus_pipe
from annulus_pipe.numeric import native
from annulus_pipe.numeric.native import DOORS, LoopDoor
from annulus_pipe.shipped import BUILD, shipped
from annulus_pipe.shipped import NATIVE as NATIVE_LIBRARY
from annulus_pipe.vocabulary import AnnulusError
from tools.wheel import hook
from tools.wheel.hook import MACHINES

NATIVE = Path(__file__).resolve().parents[3] / "host/native"
OF_C = {
    "f8": "double",
    "f4": "float",
    "i8": "int64_t",
    "i4": "int32_t",
    "i2": "int16_t",
    "u8": "uint64_t",
    "u4": "uint32_t",
    "u2": "uint16_t",
    "u1": "uint8_t",
    "b1": "bool",
}


def declaring() -> list[str]:
    package = Path(annulus_pipe.__path__[0])
    files = (path for path in package.rglob("*.py") if re.search(r"^\w+ = door\(", path.read_text(), re.M))
    return [
        ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__") for path in files
    ]


def test_every_door_is_declared_as_its_function_is_in_c() -> None:
    for name in declaring():
        importlib.import_module(name)
    in_c = {}
    for path in sorted(NATIVE.glob("*.c")):
        for result, name, arguments in re.findall(r"^DOOR (\w+) (\w+)\(([^)]*)\)", path.read_text(), re.M):
            assert name not in in_c, f"{name}: twice"
            in_c[name] = (result, [" ".join(one.split()) for one in arguments.split(",")])
    declared = {one.name: one for one in DOORS}
    assert declared.keys() == in_c.keys() - {"processor_level"}
    for name, one in declared.items():
        expected = []
        for argument in one.arguments:
            kind = OF_C[argument.kind]
            star = ("" if argument.written else "const ") + kind + "* const" if argument.is_array else f"const {kind}"
            expected.append(f"{star} {argument.name}")
        expected += [f"const int64_t {letter}" for letter in one.letters]
        assert in_c[name] == (OF_C[one.returns] if one.returns else "void", expected), name


def test_an_array_that_is_not_as_declared_is_refused_before_any_memory_is_touched() -> None:
    copied = LoopDoor("no_such_function", "f8[n,3] points", "i8[n] rank", "f8[n]! out", "f4[n]? weight")
    points, rank, out = np.zeros((4, 3)), np.zeros(4, np.int64), np.zeros(4)
    wrong = {
        "a size that disagrees": (points, rank[:3], out, None),
        "a column too many": (np.zeros((4, 4)), rank, out, None),
        "another kind": (points, rank.astype(np.int32), out, None),
        "another order": (np.zeros((3, 4)).T, rank, out, None),
        "not every element": (points, rank, np.zeros(8)[::2], None),
        "read only": (points, rank, np.frombuffer(bytes(32)), None),
        "a dimension too few": (points[:, 0].copy(), rank, out, None),
        "an optional one of another kind": (points, rank, out, np.zeros(4)),
    }
    for what, values in wrong.items():
        with pytest.raises(ValueError, match=r"no_such_function: \w+: expected"):
            copied(*values)
            pytest.fail(what)
    with pytest.raises(ValueError, match="3 arguments, expected 4"):
        copied(points, rank, out)


def test_a_library_of_other_sources_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "sources", lambda: "0123456789abcdef")
    with pytest.raises(AnnulusError, match=r"loops-.*: was built from other sources .* Run `make setup`\.$"):
        native.library.__wrapped__()


def test_another_library_in_its_place_is_refused_in_one_line(tmp_path: Path) -> None:
    other = tmp_path / "loops-other.so"
    other.write_bytes(shipped(NATIVE_LIBRARY).read_bytes())
    with pytest.raises(AnnulusError, match=r"loops-other\.so: is another library\."):
        native._load(other)


def test_a_file_that_an_editor_hides_beside_the_sources_is_none_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("level.c", "native.h"):
        (tmp_path / name).write_text(name)
    monkeypatch.setattr(native, "of_checkout", lambda name: tmp_path / Path(name).name)
    alone = native.sources.__wrapped__()
    (tmp_path / ".#level.c").symlink_to("whoever@where.1234")
    (tmp_path / "._native.h").write_text("of another system")
    assert native.sources.__wrapped__() == alone != ""


def test_a_wheel_in_an_environment_within_a_checkout_is_not_held_to_its_sources(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert native.sources.__wrapped__()
    monkeypatch.setattr(native, "is_shipped", lambda name: name == BUILD)
    assert native.sources.__wrapped__() == ""


@pytest.mark.parametrize("machine", MACHINES)
def test_a_wheel_has_a_library_of_every_level_of_its_machine(machine: str, tmp_path: Path, monkeypatch) -> None:
    """What `make` says that it would build for the hook, which ships all that is built: tests/system/test_wheel.py."""
    ran: list[tuple[str, ...]] = []
    monkeypatch.setattr(hook, "_run", lambda *command: ran.append(command))
    hook.libraries(NATIVE.parents[1], machine, tmp_path)
    (loops,) = (command for command in ran if str(NATIVE) in command)
    dry = subprocess.run([*loops, "--dry-run", "--always-make"], capture_output=True, text=True, check=True).stdout
    levels = {name for level, name in native.LEVELS.items() if (level == 0) == (machine == "aarch64")}
    assert set(re.findall(r"-shared .* -o \S*/loops-([\w-]+)\.so", dry)) == levels


@pytest.mark.parametrize("part", [0.0, 0.3, 0.99])
def test_a_library_that_is_cut_short_is_refused_and_not_loaded(tmp_path: Path, part: float) -> None:
    whole = native.shipped(f"loops-{native.level()}.so").read_bytes()
    (tmp_path / "short.so").write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(AnnulusError, match="is cut short"):
        native._load(tmp_path / "short.so")


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ("nonsense", "ANNULUS_LOOPS=nonsense: expected .*or a library's whole path"),
        ("/nowhere/loops.so", "/nowhere/loops.so: No such file"),
        (str(NATIVE), "native: Is a directory"),
    ],
)
def test_loops_chosen_that_there_are_none_of_are_refused_in_one_line(
    chosen: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(native.CHOSEN, chosen)
    monkeypatch.setattr(native, "level", native.level.__wrapped__)
    with pytest.raises(AnnulusError, match=words) as refused:
        native.library.__wrapped__()
    assert "\n" not in str(refused.value) and "make setup" not in str(refused.value)
