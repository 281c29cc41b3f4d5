"""One suite of promises for any head.

`pytest tests/hil` runs it on the firmware's native board and on the shipped image, and `pytest tests/hil --head
/dev/ttyACM0` (or socket://host:port) on what is there. On a real board tests that fire outputs want
`--i-unplugged-everything`: lamps, microwave source, turntable's driver, camera and interlock chain. Jumpers, where they
are wanted: GP8 (pin 11) to GP2 (pin 4), GP7 (pin 10) to ground (pin 13). `--analyser DRIVER`: a logic analyser that
sigrok knows, its first channels at GP3, GP4, GP5, GP6.
"""

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from head_bench import Bench

from annulus_pipe.controller import PIN_STEP, PIN_SYNC, TICK_HZ
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Arm, ArmFlag, Clear
from annulus_pipe.selftest.scope import Scope
from annulus_pipe.testing.heads import SimulatedHead

SIMULATED = ("native", "emulated")
CHANNELS = ("projector", "led", "microwave", "trigger")
UNPLUG = "fires outputs: unplug lamps, source, turntable, camera and interlock chain, then say --i-unplugged-everything"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--head", help="serial port or socket://host:port of a real head; by default two simulated ones")
    parser.addoption("--i-unplugged-everything", action="store_true", help="nothing hangs on a real head's outputs")
    parser.addoption("--analyser", help="sigrok's name of the logic analyser at a real head, as `fx2lafw`")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "kind" in metafunc.fixturenames:
        given = metafunc.config.getoption("--head", default=None)
        seen = ("emulated",) if "capture" in metafunc.fixturenames else SIMULATED
        metafunc.parametrize("kind", (given,) if given else seen)


@pytest.fixture
def head(kind: str, tmp_path: Path) -> Iterator[str]:
    """The URL of the head under test. ANNULUS_IMAGE: another image than the one built here."""
    if kind not in SIMULATED:
        yield kind
        return
    image = os.environ.get("ANNULUS_IMAGE")
    emulated = kind == "emulated"
    with SimulatedHead(
        kind,
        image=Path(image) if image and emulated else None,
        vcd=tmp_path / "run.vcd" if emulated else None,
        wires=((PIN_STEP, PIN_SYNC),),
    ) as simulated:
        yield simulated.url


@pytest.fixture
def bench(head: str) -> Iterator[Bench]:
    """Fresh from a reset, nothing armed, nothing configured."""
    client = Client(head, timeout_s=5.0)
    bench = Bench(head, client, Scope(client, head))
    bench.restart()
    yield bench
    bench.client.ask(Arm(ArmFlag(0)))
    bench.client.ask(Clear())
    bench.client.close()


@pytest.fixture
def firing(kind: str, bench: Bench, request: pytest.FixtureRequest) -> Bench:
    """A head whose outputs may fire."""
    if kind not in SIMULATED and not request.config.getoption("--i-unplugged-everything", default=False):
        pytest.skip(UNPLUG)
    return bench


@pytest.fixture
def jumpered(firing: Bench) -> Bench:
    """Whose STEP output plays the camera."""
    before = firing.scope.status().edges
    firing.scope.run_steps(3, TICK_HZ // 100)
    if firing.scope.status().edges == before:
        pytest.skip("needs a jumper from GP8 (pin 11) to GP2 (pin 4)")
    return firing


@pytest.fixture
def capture(
    kind: str, head: str, tmp_path: Path, request: pytest.FixtureRequest
) -> Callable[[Callable[[], None]], Path]:
    """What an outside analyser saw while something was done: a file that sigrok reads."""
    driver = request.config.getoption("--analyser", default=None)
    if kind not in SIMULATED and driver is None:
        pytest.skip("needs a logic analyser")
    if shutil.which("sigrok-cli") is None:
        pytest.fail("sigrok-cli is missing: Debian's sigrok-cli, which `make test` installs")

    def by_sigrok(act: Callable[[], None]) -> Path:
        file = tmp_path / "capture.sr"
        names = ",".join(f"D{i}={name}" for i, name in enumerate(CHANNELS))
        command = ["sigrok-cli", "-d", driver, "-c", "samplerate=24m", "-C", names, "--time", "3000", "-o", str(file)]
        with subprocess.Popen(command) as running:
            time.sleep(1.0)  # until it samples
            act()
            assert running.wait(30) == 0
        return file

    def by_emulator(act: Callable[[], None]) -> Path:
        act()
        return tmp_path / "run.vcd"

    return by_sigrok if driver else by_emulator
