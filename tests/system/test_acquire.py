"""A sweep from end to end, each part its own process: acquire, be killed and interrupted, resume, image."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.wings.tai.acoustic_file import load_acoustic

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(gate="tests/wings/tai/test_acquire.py::test_an_interrupted_sweep_goes_on_where_it_was"),
]

ANNULUS = [sys.executable, "-c", "from annulus_pipe.cli import main; main()"]
RADIUS_MM, STEPS = 9.0, 40
RIG = ["twin", "rig", "--phantom", "shapes", "--radius-mm", str(RADIUS_MM), "--steps-per-turn", str(STEPS)]
SWEEP = [
    "--radius-mm",
    str(RADIUS_MM),
    "--angles",
    "40",
    "--steps-per-turn",
    str(STEPS),
    "--averages",
    "64",
    "--step-us",
    "2000",
    "--period-us",
    "500",
    "--range-v",
    "0.04",
]


def run(*arguments: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*ANNULUS, *arguments], env=environment, capture_output=True, text=True, timeout=120)


def listen_to_ctrl_c() -> None:
    """Where the tests themselves run in the background of a shell, children would inherit that Ctrl-C is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def positions(out: Path) -> int:
    return len(load_acoustic(out).signals) if out.exists() else 0


def broken_off(out: Path, after: int, number: signal.Signals, *sweep: str, environment: dict[str, str]) -> int:
    """Acquire until so many angles are on the disk, then the signal."""
    shooting = subprocess.Popen(
        [*ANNULUS, "tai", "acquire", *sweep],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=listen_to_ctrl_c,
    )
    try:
        end = time.monotonic() + 90
        while positions(out) < after and shooting.poll() is None and time.monotonic() < end:
            time.sleep(0.02)
        shooting.send_signal(number)
        assert shooting.stderr is not None
        said = shooting.stderr.read()
        status = shooting.wait(30)
    finally:
        shooting.kill()
    assert b"Traceback" not in said
    return status


def test_killed_interrupted_resumed_and_imaged(traces, tmp_path: Path) -> None:
    environment, out = {**traces.environment, "OMP_NUM_THREADS": "1"}, tmp_path / "raw.hdf5"
    bench = subprocess.Popen(
        [*ANNULUS, *RIG], env=environment, stdout=subprocess.PIPE, text=True, preexec_fn=listen_to_ctrl_c
    )
    try:
        assert bench.stdout is not None
        words = bench.stdout.readline().split()
        where = words[words.index("--port") : words.index("-o")]
        port, sweep = where[1], [*where, *SWEEP, "-o", str(out)]

        assert broken_off(out, 3, signal.SIGKILL, *sweep, environment=environment) == -signal.SIGKILL
        time.sleep(0.7)  # what was armed is disarmed by the controller's host timeout
        status = json.loads(run("head", "status", "--port", port, "--json", environment=environment).stdout)
        assert "armed" not in status["state"]
        if status["fault"] != "none":
            refused = run("tai", "acquire", *sweep, "--resume", environment=environment)
            assert refused.returncode == 1 and "annulus head clear" in refused.stderr
            assert run("head", "clear", "--port", port, environment=environment).returncode == 0
        first = positions(out)
        assert first >= 3

        assert broken_off(out, first + 3, signal.SIGINT, *sweep, "--resume", environment=environment) == 130
        status = json.loads(run("head", "status", "--port", port, "--json", environment=environment).stdout)
        assert "armed" not in status["state"] and status["fault"] == "none"  # it disarmed by itself
        second = positions(out)
        assert first + 3 <= second < 40

        done = run("tai", "acquire", *sweep, "--resume", "--json", environment=environment)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["shot"] == 40 - second
        assert positions(out) == 40
    finally:
        bench.send_signal(signal.SIGINT)
        bench.wait(60)
    assert traces.left() == {}

    imaged = run(
        "tai", "image", str(out), "-o", str(tmp_path / "image"), "--pixel-mm", "0.2", "--json", environment=environment
    )
    assert imaged.returncode == 0, imaged.stderr
    assert json.loads(imaged.stdout)["excluded"] == []
    with np.load(tmp_path / "image/image.npz") as saved:
        image, x, y = saved["image"], saved["x_mm"], saved["y_mm"]
    from annulus_pipe.wings.tai.measure.phantoms import phantom

    yy, xx = np.meshgrid(y, x, indexing="ij")
    inside = np.any([part.inside(xx, yy) for part in phantom("shapes")], axis=0)
    away = ~np.any([np.hypot(xx - p.x_mm, yy - p.y_mm) < 3.0 for p in phantom("shapes")], axis=0)
    away &= np.hypot(xx, yy) < 7.5
    rms = [float(np.sqrt(np.mean(image[where] ** 2))) for where in (inside, away)]
    assert rms[0] > 4 * rms[1], rms
