"""`annulus export`, as people type it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.cli.export import To
from annulus_pipe.export import FORMS, available, open_results, write
from annulus_pipe.extras import EXTRA_OF, adds
from annulus_pipe.vocabulary import AnnulusError

FILES = {
    "pipe-tally.csv",
    "pipe-tally.xlsx",
    "cloud.laz",
    "mesh.glb",
    "pipe.dxf",
    "cloud.e57",
    "radii.csv",
    "radii.json",
}


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    code = "import sys; from annulus_pipe.cli import main; sys.argv[0] = 'annulus'; main()"
    return subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True, timeout=60)


def test_the_command_and_the_room_know_the_same_forms() -> None:
    assert {str(one) for one in To} == {*FORMS, "all"}


def test_all_is_each_form_once_beside_the_results(folder: Path) -> None:
    done = CliRunner().invoke(app, ["export", str(folder), "--to", "all", "--json"])
    assert done.exit_code == 0
    answer = json.loads(done.stdout)
    assert {Path(file).name for file in answer["files"]} == FILES and answer["skipped"] == []
    assert {file.name for file in (folder / "export").iterdir()} == FILES


def test_what_is_asked_for_is_written_where_it_is_asked_for(folder: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        app, ["export", str(folder), "--to", "glb", "--to", "pof-csv", "-o", str(tmp_path / "a/b")]
    )
    assert done.exit_code == 0 and "mesh.glb" in done.stdout
    assert {file.name for file in (tmp_path / "a/b").iterdir()} == {"mesh.glb", "pipe-tally.csv"}


def test_nothing_asked_for_a_foreign_folder_and_a_file_in_the_way_are_one_line(folder: Path, tmp_path: Path) -> None:
    for words, said in (
        ((folder,), "--to all"),
        ((tmp_path, "--to", "glb"), "summary.json"),
        ((folder, "--to", "pof-csv", "-o", folder / "cloud.ply"), "Expected a folder"),
    ):
        done = run("export", *words)
        assert done.returncode == 1 and said in done.stderr
        assert done.stderr.startswith("annulus: ") and done.stderr.count("\n") == 1


@pytest.mark.deep(but="dxf-ezdxf-export")
@pytest.mark.parametrize(
    ("form", "package", "extra"),
    [
        ("laz", "laspy", "export"),
        ("laz", "lazrs", "export"),
        ("xlsx", "openpyxl", "export"),
        ("dxf", "ezdxf", "export"),
        ("e57", "pye57", "e57"),
    ],
)
def test_a_missing_package_is_one_line_with_the_command_that_adds_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, form: str, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(AnnulusError, match=rf"{package} is not installed: .* extra \"{extra}\""):
        write(open_results(folder), [form], folder / "export")
    assert form not in available()
    done = CliRunner().invoke(app, ["export", str(folder), "--to", "all"])
    assert done.exit_code == 0
    assert adds(extra) in done.stdout and not (folder / "export" / FORMS[form].file).exists()


def test_without_a_single_extra_the_list_the_surface_and_the_radii_are_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in EXTRA_OF:
        monkeypatch.setitem(sys.modules, package, None)
    assert available() == ("pof-csv", "glb", "radii")
    assert len(write(open_results(folder), available(), folder / "export")) == 4


def test_help_says_why_not_pacp_and_not_ifc() -> None:
    said = CliRunner().invoke(app, ["export", "--help"]).stdout
    assert "Not PACP" in said and "Not IFC" in said


def test_a_form_that_fails_leaves_what_was_written_before_and_no_half_file(folder: Path) -> None:
    write(open_results(folder), ["glb", "pof-csv"], folder / "export")
    before = (folder / "export/mesh.glb").read_bytes()
    (folder / "mesh.ply").write_bytes(b"ply\n")
    with pytest.raises(AnnulusError):
        write(open_results(folder), ["glb"], folder / "export")
    assert (folder / "export/mesh.glb").read_bytes() == before
    assert {file.name for file in (folder / "export").iterdir()} == {"mesh.glb", "pipe-tally.csv"}
