"""`python -m tools.manual [FOLDER]`: build the manual, then put it in place of the old one; `make docs` calls it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tools.manual.pages import DOCS, ROOT

PLACE = ROOT / "host/annulus_pipe/shipped/manual"
USELESS = (".doctrees", ".buildinfo", "objects.inv", "_sources")


def build(place: Path) -> None:
    """Whole and without a warning, or not at all: it is made beside `place` and takes its name when it is done."""
    place.parent.mkdir(parents=True, exist_ok=True)
    new, old = (place.with_name(f".{place.name}-{what}-{os.getpid()}") for what in ("new", "old"))
    try:
        command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", "-E", str(DOCS), str(new)]
        subprocess.run(command, cwd=ROOT, check=True)
        for page in new.rglob("*.html"):  # Sphinx gives captions of the contents the role of a heading, and no level
            page.write_text(
                page.read_text("utf-8").replace('role="heading">', 'role="heading" aria-level="2">'), "utf-8"
            )
        for name in USELESS:
            shutil.rmtree(new / name) if (new / name).is_dir() else (new / name).unlink(missing_ok=True)
        if place.exists():
            place.rename(old)
        new.rename(place)
    finally:
        for leftover in (new, old):
            shutil.rmtree(leftover, ignore_errors=True)


if __name__ == "__main__":
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else PLACE
    try:
        build(where)
    except subprocess.CalledProcessError as failed:
        sys.exit(failed.returncode)
    bytes_ = sum(file.stat().st_size for file in where.rglob("*") if file.is_file())
    print(f"{where}/index.html: {bytes_ / 1e6:.1f} MB")
