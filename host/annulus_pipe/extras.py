"""Packages that only some of the work needs: imported where it begins, and where one is missing, what adds it is said.

h5py = need("h5py")  # h5py is not installed: it is part of the extra "tai". ../bin/pip install 'annulus-pipe[tai]'
"""

import importlib
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from annulus_pipe.shipped import BUILD, is_shipped
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

EXTRA_OF = {
    "cvxpy": "tai",
    "h5py": "tai",
    "pyvisa": "tai",
    "pyvisa_py": "tai",
    "laspy": "export",
    "lazrs": "export",
    "trimesh": "export",
    "ezdxf": "export",
    "openpyxl": "export",
    "pye57": "e57",
    "weasyprint": "pdf",
    "simplejpeg": "pi",
    "tifffile": "joints",
    "imagecodecs": "joints",
    "pydicom": "joints",
    "skfem": "crossbore",
    "statsmodels": "qualification",
    "starlette": "console",
    "uvicorn": "console",
    "websockets": "console",
    "foxglove": "foxglove",
    "duckdb": "archive",
    "pyarrow": "archive",
    "distributed": "cluster",
    "fsspec": "cluster",
    "s3fs": "cluster",
    "gcsfs": "cluster",
    "paramiko": "cluster",
}
"""By the name that is imported; where two extras have it, the one whose work is done more often."""


def need(module: str) -> Any:
    """An extra's module by its full name, imported. Raises AnnulusError, one line, where it cannot be."""
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise AnnulusError(f"{package} lacks {error.name}. {adds(EXTRA_OF[package])}") from None
        raise missing(package) from None
    except (ImportError, OSError) as error:  # OSError: a library of the system's that it loads
        raise AnnulusError(f"{package} is installed, and does not load: {one_line(str(error))}") from None


def missing(package: str) -> AnnulusError:
    """What is said of a package that is not there."""
    extra = EXTRA_OF[package]
    return AnnulusError(f'{package} is not installed: it is part of the extra "{extra}". {adds(extra)}')


def adds(extra: str, prefix: Path | None = None) -> str:
    """The command that adds an extra to the environment that annulus runs in."""
    prefix = prefix or Path(sys.prefix)
    if not is_shipped(BUILD):
        return f"make setup EXTRAS={extra}"
    if (prefix / "pipx_metadata.json").is_file():  # by the packages' own names: annulus may be in no index
        return "pipx inject annulus-pipe " + " ".join(f"'{one}'" for one in requirements(extra))
    return f"{prefix / 'bin/pip'} install 'annulus-pipe[{extra}]'"


def requirements(extra: str) -> Sequence[str]:
    """What an extra consists of, as pip takes it."""
    from importlib.metadata import requires  # 15 ms, of an error alone

    listed = requires("annulus-pipe") or []
    named = re.compile(rf"""extra\s*==\s*["']{re.escape(extra)}["']""")
    return [one.partition(";")[0].strip() for one in listed if named.search(one)]
