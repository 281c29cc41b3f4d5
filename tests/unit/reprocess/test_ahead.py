"""What is compiled ahead is all that a scan calls, and a process that compiles says so before it is waited for."""

import sys
from pathlib import Path

import pytest
from numba.core.registry import CPUDispatcher

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric import compiling
from annulus_pipe.numeric.telling import LINE
from annulus_pipe.reprocess import ahead
from annulus_pipe.reprocess.ahead import compile_all, make_ready, work_of
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World, demo_world, stereo_world
from tests import kept


def compiled() -> set[tuple[str, str]]:
    """Kernels of this project that this process has, by name and types."""
    modules = [module for name, module in sys.modules.items() if name.startswith("annulus_pipe.")]
    kernels = [one for module in modules for one in vars(module).values() if isinstance(one, CPUDispatcher)]
    return {
        (f"{one.py_func.__module__}.{one.py_func.__name__}", str(signature))
        for one in kernels
        if not one.py_func.__module__.startswith("annulus_pipe.twin.")
        for signature in one.signatures
    }


@pytest.mark.deep(
    gate="tests/unit/reprocess/test_ahead.py::test_what_is_ready_is_passed_by_in_silence_and_what_is_not_is_done_in_a_child"
)
@pytest.mark.parametrize("world", [demo_world(travel_mm=30.0), stereo_world(travel_mm=30.0)], ids=["ring", "stereo"])
def test_a_scan_calls_nothing_that_was_not_compiled_ahead(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiling, "is_now_ready", lambda _: None)
    kept.folder(lambda new: write_scan(world, new, 20), tmp_path / "scan", world, 20)
    job = open_job(tmp_path / "scan", tmp_path / "scan/calibration.json")
    compile_all(job.calibration)
    ahead_of_it = compiled()
    reprocess(job).survey()
    assert len(ahead_of_it) > 20
    assert compiled() - ahead_of_it == set()


def test_what_is_ready_is_passed_by_in_silence_and_what_is_not_is_done_in_a_child(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calibration: Calibration = demo_world().calibration()
    ready: list[str] = []
    said: list[str] = []
    monkeypatch.setattr(compiling, "is_ready", ready.__contains__)
    make_ready(calibration, said.append)  # loads, or compiles and says so
    assert set(said) <= {LINE}
    monkeypatch.setattr(ahead.multiprocessing, "get_context", pytest.fail)
    ready.append(work_of(calibration))
    make_ready(calibration, said.append)
    monkeypatch.setattr(compiling, "folder", lambda: None)
    ready.clear()
    make_ready(calibration, said.append)
    assert said[-1] == compiling.NOWHERE


def test_who_is_interrupted_does_not_wait_for_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "is_ready", lambda _: False)
    make_ready(demo_world().calibration(), pytest.fail, stop=lambda: True)
