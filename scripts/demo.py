#!/usr/bin/env python3
"""The main job on the bundled sample, or on files of your own: what `nox -s demo` runs.

    python scripts/demo.py [INPUT ...] [options of batch_fit.py]

Writes to out/demo/: .blend, .glb, .fbx, the take and preview.png (of one input; of several, one preview
each).
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from scripts import batch_fit

SAMPLE = ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg"
OUTPUT = ROOT / "out" / "demo"


def main() -> int:
    """Run the demo; returns the exit code."""
    defaults = ["--format", "blend,glb,fbx", "--preview", "--flat", "--output", str(OUTPUT)]
    # Before the user's own arguments, so that those win.
    arguments = [*defaults, *sys.argv[1:]]
    if not batch_fit.parse_arguments(arguments, inputs_required=False).inputs:
        arguments.append(str(SAMPLE))
    code = batch_fit.main(arguments)
    if code == 0:
        folder = batch_fit.parse_arguments(arguments).output
        for path in sorted(folder.iterdir()):
            print(f"  {path}")
    return code


if __name__ == "__main__":
    sys.exit(main())
