"""The client of compose and of Kubernetes is a command that annulus takes."""

from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from annulus_pipe.cli.app import app

DEPLOY = Path(__file__).parents[3] / "tools/deploy"


def composed() -> list[str]:
    words = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))["services"]["client"]["entrypoint"]
    assert words[0] == "begin"
    return [*words[1:], "/scans/m1.mcap"]


def in_the_job() -> list[str]:
    job = list(yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text(encoding="utf-8")))[-1]
    assert job["kind"] == "Job" and job["spec"]["suspend"] is True
    return list(job["spec"]["template"]["spec"]["containers"][0]["args"])


@pytest.mark.parametrize("words", [composed(), in_the_job()], ids=["compose", "kubernetes"])
def test_the_client_is_a_command_that_is_taken(words: list[str]) -> None:
    assert words[:2] == ["annulus", "reprocess"]
    command: Any = typer.main.get_command(app)
    told = command.commands["reprocess"].make_context("reprocess", words[2:]).params
    assert told["engine"].value == "dask" and told["scheduler"] == "tls://scheduler:8786"
    assert all(told[name] is not None for name in ("tls_ca", "tls_cert", "tls_key", "out"))
    assert told["scans"]
