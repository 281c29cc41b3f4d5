"""Truths, a survey's list, hits and misses, trials and pod.json, made wrong; what is read of them is matched, too."""

import json
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from annulus_pipe.qualification.pod import detectability, read_pod
from annulus_pipe.qualification.trial_files import read_reports, read_trials, read_truths, trials_json, truths_csv
from annulus_pipe.qualification.trials import Pull, Reported, Trials, TrueDefect, match
from annulus_pipe.report.pod_page import pod_page
from tools.bench.fuzz.mutate import HOSTILE, as_json, of_bytes, of_rows, of_values

TRUTHS = [
    TrueDefect(f"{i}", "loss", 200.0 + 90 * i, 40.0 * i, 0.1 * (i + 1), 20.0, 20.0, i % 2 == 0) for i in range(24)
]
PULL = Pull("pull", "", 0.0, 3000.0, 75.0, 0.5)
LIST = "kind,z_mm,clock_deg,depth_mm,at_least,state\nloss,210,3,1.5,no,listed\nbump,420,80,,,undecided\n"
HIT_MISS = "kind,depth_mm,beside_joint,detected,reported_depth_mm\nloss,1.5,yes,hit,1.4\nloss,0.4,no,miss,\n"
TABLES = {"truths.csv": truths_csv(TRUTHS), "list.csv": LIST, "others.csv": HIT_MISS}


def pod_case(rng: Random) -> bytes:
    name = rng.choice([*TABLES, "trials.json", "pod.json"])
    if name in TABLES:
        text = TABLES[name]
        wrong = (
            of_bytes(rng, text.encode()) if rng.random() < 0.5 else of_rows(rng, text).encode("utf-8", "surrogatepass")
        )
    else:
        wrong = as_json(rng, of_values(rng, _samples()[name], HOSTILE))
    return name.encode() + b"\0" + wrong


def pod_read(data: bytes, folder: Path) -> None:
    name, _, content = data.partition(b"\0")
    path = folder / name.decode()
    path.write_bytes(content)
    if path.name == "truths.csv":
        match(read_truths(path), [], PULL)
    elif path.name == "list.csv":
        match(TRUTHS, read_reports(path), PULL)
    elif path.name == "pod.json":
        found = read_pod(path)
        for kind in found.kinds:
            "\n".join(found.statement(kind)).encode()
        pod_page(found, {f"pod-{kind}": b"" for kind in found.kinds}).encode()
    else:
        detectability(read_trials(path))


@cache
def _samples() -> dict[str, Any]:
    reported = [Reported("loss", one.z_mm, one.clock_deg, one.depth_mm) for one in TRUTHS if one.depth_mm > 0.8]
    found = match(TRUTHS, reported, PULL)
    study = detectability(Trials(found.trials, found.pulls))
    return {"trials.json": json.loads(trials_json(found)), "pod.json": study.to_dict()}
