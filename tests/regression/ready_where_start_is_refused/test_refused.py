"""On a disk that was full or read-only Start was refused, and the page said: Ready, press Start."""

import json
import os
import re
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import annulus_pipe.console
from annulus_pipe.daemon import disk
from annulus_pipe.daemon.config import HeadConfig, RecordConfig
from annulus_pipe.daemon.health import Word
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.vitals import Vitals
from annulus_pipe.vocabulary import AnnulusError

STATIC = Path(annulus_pipe.console.__file__).with_name("static")
PAGE = """
class Place {
  constructor() { this.children = []; this.dataset = {}; this.textContent = ""; this.hidden = false; this.kept = {}; }
  querySelector(of) { return (this.kept[of] ??= new Place()); }
  setAttribute(name, value) { this[name] = name === "hidden" ? true : value; }
  removeAttribute() {}
  addEventListener() {}
  append(...more) { this.children.push(...more); }
}
globalThis.document = { createElement: () => new Place(), activeElement: null };
globalThis.localStorage = { getItem: () => null };
const WORDS = TEXTS;
const root = new Place();
const app = {
  t: (key, with_ = {}) => (WORDS[key] ?? key).replace(/{(\\w+)}/g, (_, name) => with_[name] ?? ""),
  word: (_, name) => name, latest: LATEST, connection: { state: "live" }, on: () => {}, commanding: false,
};
mountState(root, app);
const start = root.kept["#state-actions"].children.find((one) => one.id === "do-start");
console.log(JSON.stringify([root.kept["#state-word"].textContent, root.kept["#state-next"].textContent, start.hidden]));
"""


def page(telemetry: dict[str, Any]) -> list[Any]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Debian's nodejs")
    modules = [(STATIC / name).read_text(encoding="utf-8") for name in ("dom.js", "state.js")]
    own = re.sub(r"^import .*$|^export ", "", "\n".join(modules), flags=re.MULTILINE)
    texts = (STATIC / "strings/en.json").read_text(encoding="utf-8")
    latest = {"state": {"state": "idle"}, "telemetry": telemetry, "health": {"health": "ok"}}
    program = f"const TEXTS = {texts}, LATEST = {json.dumps(latest)};\n{own}\n{PAGE}"
    ran = subprocess.run([node], input=f"{{{program}}}", capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return list(json.loads(ran.stdout))


def looked(config: HeadConfig) -> tuple[dict[str, Any], Vitals]:
    """The disk's numbers of an idle head, once it was asked."""
    vitals = Vitals(config, 1e6, Observer())
    telemetry = {"frames": {}, "recorded": 0, "drops": {}, "state": "idle", "disk": {}}
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        vitals.look(telemetry, "", scanning=False)
        if vitals.numbers()["refuses"] or vitals.numbers()["free_gb"] is not None:
            vitals.look({**telemetry, "disk": vitals.numbers()}, "", scanning=False)
            break
        time.sleep(0.005)
    return vitals.numbers(), vitals


@pytest.mark.parametrize("why", ["full", "read-only", "a file"])
def test_a_disk_on_which_start_is_refused_is_a_state_of_its_own(
    tmp_path: Path, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = HeadConfig(record_folder=tmp_path / "scans", record=RecordConfig(min_free_gb=0.0, reserve_mb=0.0))
    says = "expected at least 1e+06 GB"
    if why == "full":
        config = replace(config, record=replace(config.record, min_free_gb=1e6))
    elif why == "read-only":
        says, real = "Read-only file system", os.statvfs

        def mounted_read_only(path: Any) -> os.statvfs_result:
            told = list(real(path))
            told[8] |= os.ST_RDONLY
            return os.statvfs_result(told)

        monkeypatch.setattr(disk.os, "statvfs", mounted_read_only)
        monkeypatch.setattr(disk.os, "access", lambda *_: False)
    else:
        says = "Not a directory"
        (tmp_path / "scans").write_text("")
    numbers, vitals = looked(config)
    try:
        assert says in numbers["refuses"] and "\n" not in numbers["refuses"]
        assert vitals.health.word is Word.DEGRADED and says in vitals.health.why
        with pytest.raises(AnnulusError, match=re.escape(says)):
            vitals.require_space()
    finally:
        vitals.close()
        monkeypatch.undo()
    word, hint, start_hidden = page({"disk": numbers})
    assert (word, start_hidden) == ("Cannot record", True) and numbers["refuses"] in hint and "Make room" in hint


def test_a_disk_with_room_is_ready(tmp_path: Path) -> None:
    config = HeadConfig(record_folder=tmp_path, record=RecordConfig(min_free_gb=0.0, reserve_mb=0.0))
    numbers, vitals = looked(config)
    vitals.close()
    assert numbers["refuses"] == ""
    assert page({"disk": numbers}) == ["Ready", "Lamps are dark. Press Start when the head is in the pipe.", False]
