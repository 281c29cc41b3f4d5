"""A fifth wing is its own folder and nothing else: the core finds it by that, hook by hook."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

INIT = '''"""Echoes of an ultrasonic head: no method yet."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from annulus_pipe.hooks import Noun, Sheet, WingResults


@dataclass(frozen=True)
class EchoJob:
    scan: Any
    refuses: Mapping[str, str] = field(default_factory=lambda: {"colour": "echoes: they have none"})


def opens(scan: Any, calibration: Any, by: str) -> EchoJob | None:
    if not str(scan).endswith(".echo"):
        return None
    from annulus_pipe.scans.scan import Scan

    return EchoJob(Scan(scan, (), None, None))


def measured(job: EchoJob, executor: Any, place: Any, out: Any, account: Any, **how: Any) -> WingResults:
    (out / "echo.txt").write_text(account.source)
    return WingResults({"echoes": 0}, ("echoes     none: no method yet",))


def watches(config: Any, observers: Any) -> None:
    observers.event("ultrasound", "listening")


def adds(survey: Any, scan: Any, profiles: Any) -> Any:
    return replace(survey, beside={**survey.beside, "ultrasound": 1})


def sheet(survey: Any) -> Sheet | None:
    return Sheet("Echoes", b"", "nothing", "None.", {"echoes": 0}) if "ultrasound" in survey.beside else None


def worlds() -> Mapping[str, Callable[[int], Any]]:
    from annulus_pipe.twin.worlds import clean_world

    return {"tank": clean_world}


def app() -> Mapping[str, Noun]:
    return {"ultrasound": Noun("annulus_pipe.wings.ultrasound.commands", "Echoes of an ultrasonic head.")}
'''
COMMANDS = '''"""`annulus ultrasound`."""

from annulus_pipe.cli.show import verbs

app = verbs()


@app.command("listen", epilog="Example: annulus ultrasound listen")
def listen() -> None:
    """Nothing yet."""
    print("silence")
'''
ASKED = """
import sys
import annulus_pipe.hooks as hooks
import annulus_pipe.wings as wings
wings.__path__.append(sys.argv.pop(1))
"""


@pytest.fixture
def fifth(tmp_path: Path) -> Path:
    folder = tmp_path / "wings" / "ultrasound"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text(INIT)
    (folder / "commands.py").write_text(COMMANDS)
    return folder.parent


def run(fifth: Path, code: str, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", ASKED + code, str(fifth), *words], capture_output=True, text=True, check=False
    )


def test_its_commands_worlds_and_scans_are_there_by_its_folder_alone(fifth: Path, tmp_path: Path) -> None:
    main = "from annulus_pipe.cli import main; main()"
    assert run(fifth, main, "ultrasound", "listen").stdout == "silence\n"
    assert "ultrasound" in run(fifth, main, "--help").stdout
    assert "tank" in run(fifth, main, "twin", "scan", "--world", "nowhere", "-o", str(tmp_path / "no")).stderr
    (tmp_path / "a.echo").write_bytes(b"")
    done = run(fifth, main, "reconstruct", str(tmp_path / "a.echo"), "-o", str(tmp_path / "out"))
    assert done.stdout.startswith("echoes     none: no method yet\nreport  ") and (tmp_path / "out/echo.txt").is_file()
    done = run(fifth, main, "reconstruct", str(tmp_path / "a.echo"), "-o", str(tmp_path), "--colour", "x.json")
    assert done.stderr == "annulus: --colour does not go with echoes: they have none\n"
    done = run(fifth, main, "reprocess", str(tmp_path / "a.echo"), "-o", str(tmp_path / "season"), "--json")
    assert json.loads(done.stdout)["scans"][0]["ok"], done.stderr


def test_a_running_head_and_a_survey_ask_it(fifth: Path) -> None:
    code = """
from dataclasses import make_dataclass
Heard = type("Heard", (), {"event": lambda self, kind, text: print(kind, text), "all": []})
from annulus_pipe.daemon.config import SectorsConfig
config = type("Config", (), {"sectors": SectorsConfig()})()
hooks.watch(config, Heard())
survey = make_dataclass("Survey", ["beside"])({})
one = next(wing for wing in wings.found() if wing.__name__.endswith("ultrasound"))
print([sheet.title for sheet in hooks.sheets(one.adds(survey, None, ()))])
"""
    done = run(fifth, code)
    assert "ultrasound listening" in done.stdout and "['Echoes']" in done.stdout, done.stderr


def test_a_wing_that_cannot_be_loaded_is_one_line_and_two_may_share_a_noun(fifth: Path) -> None:
    main = "from annulus_pipe.cli import main; main()"
    other = fifth / "zeta"
    other.mkdir()
    shared = """
from typer import Typer
app = Typer()
app.command("zeta")(lambda: print("zeta"))
"""
    (other / "commands.py").write_text(shared)
    (other / "__init__.py").write_text(
        "from annulus_pipe.hooks import Noun\n\ndef app():\n    return {'calibrate': Noun(f'{__name__}.commands')}\n"
    )
    assert "zeta" in run(fifth, main, "calibrate", "--help").stdout
    assert run(fifth, main, "calibrate", "fringe", "--help").returncode == 0
    (other / "__init__.py").write_text("def worlds():\n    return {'tank': None}\n")
    done = run(fifth, main, "twin", "scan", "--world", "tank", "-o", str(fifth / "no"))
    assert "two have 'tank' among their worlds" in done.stderr and done.stderr.count("\n") == 1
    (other / "__init__.py").write_text("def (:")
    done = run(fifth, main, "--version")
    assert done.returncode == 1 and "wings/zeta: cannot be loaded (SyntaxError" in done.stderr
    assert done.stderr.count("\n") == 1
