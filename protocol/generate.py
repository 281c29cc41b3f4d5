#!/usr/bin/env python3
"""Makes every file that depends on messages.toml. `--check` writes nothing and fails when a committed file is stale.

Standard library only: the firmware build and CI run it before any environment exists.
"""

import json
import sys
from pathlib import Path

from generator import c, dispatch, docs, javascript, python
from generator.schema import load
from generator.vectors import vectors

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent


def main(arguments: list[str]) -> int:
    if arguments not in ([], ["--check"]):
        print("usage: generate.py [--check]", file=sys.stderr)
        return 2
    protocol = load(HERE / "messages.toml")
    golden = vectors(protocol)
    readme = ROOT / "firmware/README.md"
    files = {
        ROOT / "firmware/core/messages.h": c.c_header(protocol),
        ROOT / "firmware/core/messages.c": c.c_source(protocol),
        ROOT / "firmware/core/dispatch.h": dispatch.dispatch_header(protocol),
        ROOT / "firmware/core/dispatch.c": dispatch.dispatch_source(protocol),
        ROOT / "firmware/pins.h": c.c_pins(protocol),
        ROOT / "firmware/tests/vectors.c": c.c_vectors(protocol, golden),
        ROOT / "host/annulus_pipe/controller.py": python.controller_module(protocol),
        ROOT / "host/annulus_pipe/link/messages.py": python.messages_module(protocol),
        ROOT / "tools/emulator/controller.mjs": javascript.controller_module(protocol),
        HERE / "REFERENCE.md": docs.reference(protocol),
        HERE / "vectors.json": json.dumps(golden, indent=1) + "\n",
        readme: docs.readme_with_tables(protocol, readme.read_text()),
    }
    stale = [path for path, text in files.items() if not path.is_file() or path.read_text() != text]
    for path in stale:
        if arguments:
            print(f"stale: {path.relative_to(ROOT)}; run protocol/generate.py", file=sys.stderr)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(files[path])
            print(f"written: {path.relative_to(ROOT)}")
    return 1 if arguments and stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
