"""Reconstructs the scenes one after the other, in this process, and prints what their scores say."""

import argparse
import importlib.util
import json
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import Any

from annulus_pipe.cli.limits_file import load_limits
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.wall.conformity import judge
from tools.bench.scenes import __doc__ as purpose
from tools.bench.scenes.blind import FRAMES, blind_checks, draw
from tools.bench.scenes.elbow import ELBOW, elbow_checks
from tools.bench.scenes.judge import TARGETS, Check, feature_checks, pocket_bias, scene_checks
from tools.bench.table import SCENES

SCORER = "score_real.py"
HEAD = (
    "scene",
    "rms mm (centred)",
    "gross >2 mm",
    "wrong >1 mm",
    "completeness",
    "seen",
    "found/misnamed/missed/false",
    "k=2 covers (centred)",
    "CPU s",
)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.bench scenes", description=purpose.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=SCENES / "pipes")
    parser.add_argument("--only", nargs="+", metavar="SCENE", default=[], help="names of scenes; all if not given")
    parser.add_argument("--keep", type=Path, help="folder that keeps every scene's results")
    parser.add_argument(
        "--blind",
        type=int,
        metavar="SEED",
        help="instead of a folder's, what the twin draws of pipes with joints, "
        "a bend, an opening, water; they stay beside the results that are kept",
    )
    asked = parser.parse_args(arguments)
    if asked.blind is not None:
        return _blind(asked.blind, asked.only, asked.keep)
    scorer = asked.folder / SCORER
    if not scorer.is_file():
        print(f"{asked.folder}: no {SCORER} there, so no scenes with truth", file=sys.stderr)
        return 2
    scenes = sorted(path.parent for path in asked.folder.glob("*/truth.json"))
    elbow = asked.folder.parent / ELBOW
    names = [scene.name for scene in scenes] + ([ELBOW] if elbow.is_dir() else [])
    if unknown := set(asked.only) - set(names):
        print(f"no such scene: {', '.join(sorted(unknown))}; there are {', '.join(names)}", file=sys.stderr)
        return 2
    wanted = set(asked.only or names)
    score_real = load(scorer)
    with tempfile.TemporaryDirectory() as scratch:
        results = asked.keep or Path(scratch)
        table, scores, missed = [], [], 0
        for scene in scenes:
            if scene.name not in wanted:
                continue
            row, score, wrong = _scene(scene, results / scene.name, score_real)
            table.append(row)
            missed += wrong
            if score is not None:
                scores.append(score)
        missed += _show([pocket_bias(scores)], "all scenes") if scores else 0
        if ELBOW in wanted:
            missed += _elbow(elbow, results / ELBOW)
    print("\nTargets:", TARGETS, sep="\n", end="\n\n")
    for cells in [HEAD, ["---"] * len(HEAD), *table]:
        print(f"| {' | '.join(cells)} |")
    print(f"\n{missed} targets missed" if missed else "\nevery target met")
    return 1 if missed else 0


def _blind(seed: int, only: list[str], keep: Path | None) -> int:
    if unknown := set(only) - set(FRAMES):
        print(f"no such scene: {', '.join(sorted(unknown))}; there are {', '.join(FRAMES)}", file=sys.stderr)
        return 2
    missed = 0
    with tempfile.TemporaryDirectory() as scratch:
        for world in only or FRAMES:
            scan, out = ((keep or Path(scratch)) / f"{world}-{seed}{end}" for end in ("", "-results"))
            try:
                if not (scan / "truth.json").is_file():
                    draw(world, seed, scan)
                measure(scan, out)
                missed += _show(list(blind_checks(scan, out)), world)
            except Exception as error:  # must not cost the other scenes
                missed += _show(
                    [Check("broke", f"{type(error).__name__}: {' '.join(str(error).split())}", False)], world
                )
    print(f"\n{missed} targets missed" if missed else "\nevery target met")
    return 1 if missed else 0


def load(path: Path) -> ModuleType:
    """A scorer as the module it is."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def measure(scene: Path, out: Path, limits: Path | None = None) -> float:
    """Every result file of a scene in `out`, its verdict too where there are limits; CPU seconds, page included."""
    began = time.process_time()
    done = reprocess(open_job(scene, scene / "calibration.json"))
    survey = done.survey()
    verdict = None if limits is None else judge(survey, load_limits(limits))
    account = ScanAccount(scene.name, done.frames, done.drops, done.timing_ms, done.findings, verdict=verdict)
    write(survey, account, out)
    return time.process_time() - began


def _scene(scene: Path, out: Path, score_real: ModuleType) -> tuple[list[str], dict[str, Any] | None, int]:
    """Its row of the table, its score, and how many targets it missed."""
    try:
        spent = measure(scene, out)
        score = score_real.score(str(out), str(scene / "truth.json"))
    except Exception as error:  # must not cost the other scenes
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return [scene.name, reason, *[""] * (len(HEAD) - 2)], None, _show([Check("broke", reason, False)], scene.name)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    truth = json.loads((scene / "truth.json").read_text(encoding="utf-8"))
    page = (out / "report.html").read_text(encoding="utf-8")
    whole = list(scene_checks(score, page, len(summary.get("undecided", ()))))
    by_name = {check.what: check.text for check in whole}
    missed = _show(whole, scene.name)
    for one in score["features"]:
        missed += _show(list(feature_checks(one, truth, summary["features"])), f"  {one['name']} {one['z']}")
    for line in score["false"]:
        print(f"    false: {line}")
    row = [
        scene.name,
        f"{score['rms_mm']:.3f} ({score['rms_centred_mm']:.3f})",
        by_name["gross"],
        f"{score['wrong_percent']:.2f} %",
        f"{score['completeness']:.3f}",
        f"{score['seen_percent']:.0f} %",
        by_name["list"],
        by_name["k2"],
        f"{spent:.1f}",
    ]
    return row, score, missed


def _elbow(scene: Path, out: Path) -> int:
    """The bend beside the scenes, where its scorer is there and the survey has written a centre line."""
    scorer = scene.parent / "score_elbow.py"
    try:
        measure(scene, out)
    except Exception as error:
        return _show([Check("broke", f"{type(error).__name__}: {error}", False)], scene.name)
    if not scorer.is_file() or not (out / "centreline.json").is_file():
        print(f"{scene.name}: left out, no {'centreline.json was written' if scorer.is_file() else scorer.name}")
        return 0
    return _show(list(elbow_checks(load(scorer), out, scene / "truth" / "truth.json")), scene.name)


def _show(checks: list[Check], name: str) -> int:
    """Prints one line; what missed is marked. How many did."""
    marks = {True: "", False: " **missed**", None: ""}
    print(f"{name}: " + "; ".join(f"{c.what} {c.text}{marks[c.ok]}".strip() for c in checks), flush=True)
    return sum(check.ok is False for check in checks)
