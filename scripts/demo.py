#!/usr/bin/env python3
"""The main job on the bundled samples, or on files of your own: what `nox -s demo` runs.

    python scripts/demo.py [INPUT ...] [options of batch_fit.py]

Writes to out/demo/, per input: .blend, .glb, .fbx, the take, a contact sheet and a preview; and
overview.html, which shows them all.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from scripts import batch_fit

SAMPLES = [
    str(ROOT / "samples" / name) for name in ("mona_lisa/mona_lisa.jpg", "rendered_hand/hand.%04d.jpg")
]
OUTPUT = ROOT / "out" / "demo"


def main() -> int:
    """Run the demo; returns the exit code."""
    # Before the user's own arguments, so that those win.
    arguments = ["--format", "blend,glb,fbx", "--preview", "--flat", "--output", str(OUTPUT), *sys.argv[1:]]
    args = batch_fit.parse_arguments(arguments, SAMPLES)
    code = batch_fit.main(arguments, SAMPLES)
    report = args.output / "report.json"
    if report.is_file():
        entries = json.loads(report.read_text(encoding="utf-8"))["inputs"]
        for name in ("overview.html", *(name for entry in entries for name in entry["files"])):
            print(f"  {args.output / name}")
    return code


if __name__ == "__main__":
    sys.exit(main())
