#!/usr/bin/env python3
"""The main job on the bundled sample, or on files of your own: what `nox -s demo` runs.

    python scripts/demo.py [INPUT ...] [options of batch_fit.py]

Writes to out/demo/: .blend, .glb, .fbx, the take and preview.png (one preview per input, if there are
several).
"""

from __future__ import annotations

import json
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
    report_path = args.output / "report.json"
    if not report_path.is_file():
        return code
    report = json.loads(report_path.read_text(encoding="utf-8"))
    entries = report["inputs"]
    if len(entries) == 1:
        entries[0]["files"] = [_plainly_named(args.output, name) for name in entries[0]["files"]]
        report_path.write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    for name in (name for entry in entries for name in entry["files"]):
        print(f"  {args.output / name}")
    return code


def _plainly_named(folder: Path, name: str) -> str:
    """The only preview there is becomes preview.png; other files keep their names."""
    if not name.endswith(".preview.png"):
        return name
    (folder / name).replace(folder / "preview.png")
    return "preview.png"


if __name__ == "__main__":
    sys.exit(main())
