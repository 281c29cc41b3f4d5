"""What other people's tests stand on: heads behind a mocked port, the same every time, and no price for those who use
none.
"""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import annulus_pipe.testing
from annulus_pipe.controller import PIN_LED
from annulus_pipe.link import operate
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Arm, ArmFlag, Commit, Edge, Fault, FaultCode, Ping
from annulus_pipe.link.session import EventReceived, EventsLost
from annulus_pipe.link.stage import stage_from_us
from annulus_pipe.testing.heads import ScriptedHead, SimulatedHead

PAGE = Path(annulus_pipe.testing.__file__).with_name("README.md")
STAGE = stage_from_us(
    ratio=0, period_us=20000, exposure_us=19000, readout_us=10000, projector_us=(0, 0), led_us=(2000, 1000)
)


def configured(client: Client) -> None:
    for command in (STAGE, Commit(STAGE.generation), Arm(ArmFlag.LAMPS)):
        client.request(command)


def test_the_pages_example_runs_as_it_stands(tmp_path: Path) -> None:
    """In a pytest of its own, with nothing of ours but the installed plugin."""
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    (tmp_path / "test_rig.py").write_text(example)
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert "2 passed" in run.stdout, run.stdout + run.stderr


def test_the_plugin_imports_nothing_of_ours_before_a_test_asks() -> None:
    code = (
        "import sys, annulus_pipe.testing.plugin;"
        "print([m for m in sys.modules if m.split('.')[0] in ('annulus_pipe', 'numpy', 'serial')])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "['annulus_pipe', 'annulus_pipe.testing', 'annulus_pipe.testing.plugin']"


def test_heads_need_no_pytest() -> None:
    code = "import sys; sys.modules['pytest'] = None; import annulus_pipe.testing.heads"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_same_test_gives_the_same_pins() -> None:
    def pins() -> list[int]:
        with SimulatedHead(camera_fps=50.0) as head, Client(head.url) as client:
            configured(client)
            head.run(0.3)
            return head.rises(PIN_LED)

    assert len(pins()) >= 13
    assert pins() == pins()


def test_a_clients_patience_is_measured_in_the_heads_time(head: SimulatedHead) -> None:
    head.camera(50.0)
    with Client(head.url) as client:
        configured(client)
        began = client.now_s()
        faults = []
        while client.now_s() < began + 2.0:  # far beyond the host timeout, in no time
            client.keep_alive()
            faults += [h for h in client.poll(0.1) if isinstance(h, EventReceived) and isinstance(h.event, Fault)]
        assert faults == []
        head.run(0.6)
        assert FaultCode.HOST_TIMEOUT in [
            h.event.fault for h in client.poll(0.1) if isinstance(h, EventReceived) and isinstance(h.event, Fault)
        ]


def test_a_bad_line_costs_repeats_and_no_command(faulty_head: Callable[..., SimulatedHead]) -> None:
    head = faulty_head("rough", seed=5)
    lost = 0
    edges = []
    with Client(head.url, timeout_s=5.0) as client:
        configured(client)
        for _ in range(200):
            client.request(Ping(), timeout_s=5.0)
            for happening in client.poll(0.01):
                lost += happening.count if isinstance(happening, EventsLost) else 0
                if isinstance(happening, EventReceived) and isinstance(happening.event, Edge):
                    edges.append(happening.event.edge)
    assert len(edges) >= 40
    assert lost == 0
    assert sorted(edges) == list(range(min(edges), min(edges) + len(edges)))  # what was lost came by another way


def test_another_process_may_use_a_head_in_real_time(head: SimulatedHead) -> None:
    with head.live() as url:
        assert operate.status(url)["board"] == "native"


def test_a_script_hears_every_command(scripted_head: ScriptedHead) -> None:
    with Client(scripted_head.url) as client:
        client.request(Arm(ArmFlag.LAMPS))
    assert scripted_head.controller.executed[-1] == Arm(ArmFlag.LAMPS)
