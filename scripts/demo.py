#!/usr/bin/env python3
"""The main job on the bundled sample, or on files of your own: what `nox -s demo` runs.

    python scripts/demo.py [INPUT ...] [options of batch_fit.py]

Writes to out/demo/: .blend, .glb, .fbx, the take and preview.png (one preview per input, if there are
several).
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
    # Before the user's own arguments, so that those win.
    arguments = ["--format", "blend,glb,fbx", "--preview", "--flat", "--output", str(OUTPUT), *sys.argv[1:]]
    args = batch_fit.parse_arguments(arguments, [str(SAMPLE)])
    code = batch_fit.main(arguments, [str(SAMPLE)])
    if args.output.is_dir():
        previews = list(args.output.glob("*.preview.png"))
        if len(previews) == 1:
            previews[0].replace(args.output / "preview.png")
        for path in sorted(p for p in args.output.iterdir() if p.is_file()):
            print(f"  {path}")
    return code


if __name__ == "__main__":
    sys.exit(main())
