"""Compiled code is used for as long as nothing it was made of changed, and who waits for a compiler is told once."""

import json
import os
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from types import FunctionType

import pytest

from annulus_pipe.numeric import compiling, jit, telling

CALLER = """
from annulus_pipe.numeric.jit import jit
from callee import WEIGHT, half

@jit
def weighed(x):
    return WEIGHT * half(x)
"""
CALLEE = """
from annulus_pipe.numeric.jit import jit
WEIGHT = {weight}

@jit
def half(x):
    return x / {divisor}
"""
RUN = """
import sys
sys.path.insert(0, {folder!r})
from annulus_pipe.numeric import telling
telling.MOMENT_S = {moment}
from caller import weighed
with telling.telling(lambda line: print("told", line)):
    print(weighed(12.0), len(weighed.stats.cache_hits))
"""


def run(folder: Path, monkeypatch: pytest.MonkeyPatch, moment: float = 60.0) -> list[str]:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder / "kept"))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")  # a file rewritten within its second is read anew
    code = RUN.format(folder=str(folder), moment=moment)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def write(folder: Path, weight: float = 1.0, divisor: float = 2.0) -> None:
    (folder / "caller.py").write_text(CALLER)
    (folder / "callee.py").write_text(CALLEE.format(weight=weight, divisor=divisor))


@pytest.mark.deep(gate="tests/unit/numeric/test_compiling.py::test_a_kernel_is_the_same_to_whoever_imports_it")
def test_a_kernel_is_compiled_anew_when_another_files_kernel_or_constant_in_it_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an upgrade does: the caller's own file is the same to the byte."""
    write(tmp_path)
    assert run(tmp_path, monkeypatch) == ["6.0 0"]
    assert run(tmp_path, monkeypatch) == ["6.0 1"]  # kept
    write(tmp_path, divisor=4.0)
    assert run(tmp_path, monkeypatch) == ["3.0 0"]
    write(tmp_path, weight=5.0, divisor=4.0)
    assert run(tmp_path, monkeypatch) == ["15.0 0"]
    assert run(tmp_path, monkeypatch) == ["15.0 1"]


TAKES = """
from typing import NamedTuple
from annulus_pipe.numeric.jit import jit

class {name}(NamedTuple):
    radius: float

@jit
def half(tube):
    return tube.radius / 2.0

def weighed(x):
    return half({name}(x))
weighed.stats = half.stats
"""


def test_kept_code_that_names_a_class_of_an_older_version_is_compiled_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, hits in (("Tube", 0), ("Tube", 1), ("Pipe", 0), ("Pipe", 1)):
        (tmp_path / "caller.py").write_text(TAKES.format(name=name))
        assert run(tmp_path, monkeypatch) == [f"6.0 {hits}"]


def test_who_waits_is_told_once_and_not_when_nothing_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path)
    assert run(tmp_path, monkeypatch, moment=0.0) == [f"told {telling.LINE}", "6.0 0"]
    assert run(tmp_path, monkeypatch, moment=0.0) == ["6.0 1"]


def test_the_note_holds_for_this_source_and_goes_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "folder", lambda: tmp_path)
    assert not compiling.is_ready("slits-1")
    compiling.is_now_ready("slits-1")
    compiling.is_now_ready("line-1")
    assert compiling.is_ready("slits-1")
    monkeypatch.setattr(compiling, "_state", lambda: "another source")
    assert not compiling.is_ready("slits-1")
    compiling.is_now_ready("slits-1")
    assert len(list(tmp_path.glob("ahead-slits-1.*"))) == 1
    assert len(list(tmp_path.glob("ahead-line-1.*"))) == 1


def test_the_note_goes_by_the_processor_that_is_compiled_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """An image is compiled once, for one kind of processor, and its note holds on whatever machine it runs."""
    from llvmlite import binding
    from numba import config

    def state() -> str:
        return compiling._state.__wrapped__()

    here = state()
    monkeypatch.setattr(config, "CPU_NAME", "x86-64-v3")
    monkeypatch.setattr(config, "CPU_FEATURES", "+avx2,+fma")
    image = state()
    monkeypatch.setattr(binding, "get_host_cpu_name", lambda: "another")
    assert state() == image != here
    monkeypatch.setattr(config, "CPU_NAME", None)
    monkeypatch.setattr(config, "CPU_FEATURES", None)
    assert state() not in (image, here)


def test_where_nothing_can_be_kept_nothing_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "folder", lambda: None)
    compiling.is_now_ready("slits-1")
    assert not compiling.is_ready("slits-1")


ALL = """
import importlib, json, pkgutil, annulus_pipe
names = [one.name for one in pkgutil.walk_packages(annulus_pipe.__path__, "annulus_pipe.")]
names = [name for name in names if ".shipped." not in name]
for name in sorted(names, reverse={reverse}):
    importlib.import_module(name)
from annulus_pipe.numeric.jit import _stamps
print(json.dumps(_stamps, sort_keys=True))
"""


@pytest.mark.deep(gate="tests/unit/numeric/test_compiling.py::test_a_kernel_is_the_same_to_whoever_imports_it")
def test_what_a_kernel_is_known_by_is_the_same_in_every_process() -> None:
    """Whatever was imported first, and however texts are hashed there: else nothing compiled would be found again."""
    said = [
        subprocess.run(
            [sys.executable, "-c", ALL.format(reverse=reverse)],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for reverse, seed in ((False, "1"), (True, "2"))
    ]
    assert said[0] == said[1]
    assert json.loads(said[0])


def test_a_kernel_is_the_same_to_whoever_imports_it() -> None:
    """pytest puts names of its own into the modules it reads. Code was then compiled anew by turns, and what one
    process had compiled and another loaded was not the same to the bit."""
    here = dict(vars(jit))
    read_by_pytest = FunctionType(jit.cos_sin.py_func.__code__, {**here, "@pytest_ar": object()})
    by_others = FunctionType(
        jit.cos_sin.py_func.__code__, {name: value for name, value in here.items() if name.isidentifier()}
    )
    stamps = []
    for function in (read_by_pytest, by_others):
        jit._stamps.pop(function.__code__.co_filename, None)
        stamps.append(jit.stamp_of(function))
    assert stamps[0] == stamps[1]


def test_a_kernel_is_another_when_a_named_tuple_it_takes_has_its_fields_in_another_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel = jit.cos_sin.py_func.__code__
    stamps = set()
    for tube in (namedtuple("Tube", "radius length"), namedtuple("Tube", "length radius")):
        monkeypatch.setattr(jit, "_stamps", {})
        stamps.add(jit.stamp_of(FunctionType(kernel, vars(jit) | {"Tube": tube})))
    assert len(stamps) == 2
