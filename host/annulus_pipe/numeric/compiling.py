"""What was compiled ahead is known without compiling.

    if not is_ready("slits-1"): ...          # a note beside the compiled code: all of that work's loops are there

The note holds for one source, one numba and one kind of processor. It is a hint: what is stale is known kernel by
kernel (numeric.jit), and is compiled where it is called.
"""

import functools
import hashlib
import importlib.metadata
import sys
import tempfile
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any

NOWHERE = "compiled loops cannot be kept, every process compiles anew: set NUMBA_CACHE_DIR to a folder of your own"
_DECORATORS = (b"@jit", b"jit_with")  # a file with one of these has kernels


def folder() -> Path | None:
    """Where compiled code of this package is kept: beside the modules, in the user's cache, or where NUMBA_CACHE_DIR
    says; None where nothing can be written, and every process compiles anew."""
    from annulus_pipe.numeric.jit import cos_sin  # numba takes a second to be there

    path = getattr(getattr(cos_sin, "_cache", None), "cache_path", None)
    if path is None:
        return None
    try:
        with tempfile.TemporaryFile(dir=path):
            return Path(path)
    except OSError:
        return None


def is_ready(what: str) -> bool:
    """Whether all that this work needs was compiled here before."""
    kept = folder()
    return kept is not None and _note(kept, what).is_file()


def is_now_ready(what: str) -> None:
    """Leaves the note, and takes away those of other sources."""
    kept = folder()
    if kept is None:
        return
    note = _note(kept, what)
    with suppress(OSError):
        for old in kept.glob(f"ahead-{what}.*.nbi"):
            old.unlink(missing_ok=True)
        note.write_bytes(b"")


def _note(kept: Path, what: str) -> Path:
    return kept / f"ahead-{what}.{_state()}.nbi"  # goes with the compiled code when that is cleared


@functools.cache
def _state() -> str:
    """Of all that compiled code depends on, in 16 digits: the kernels' sources, numba, Python, the processor."""
    from llvmlite import binding
    from numba import config

    digest = hashlib.sha256()
    for path in sorted(Path(str(resources.files("annulus_pipe"))).rglob("*.py")):
        content = path.read_bytes()
        if any(word in content for word in _DECORATORS):
            digest.update(content)
    versions = [importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy")]
    name, features = config.CPU_NAME, config.CPU_FEATURES  # NUMBA_CPU_NAME: code for one kind, on machines of many
    if name is None or features is None:
        here: Any = binding.get_host_cpu_features()
        name, features = name or binding.get_host_cpu_name(), features or here.flatten()
    about = (*versions, sys.implementation.cache_tag, name, features)
    digest.update(repr(about).encode())
    return digest.hexdigest()[:16]
