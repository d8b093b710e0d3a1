#!/usr/bin/env python3
"""The main job on the bundled samples, or on files of your own: what `nox -s demo` runs.

    python scripts/demo.py [INPUT ...] [options of batch_fit.py]

Writes to out/demo/, per input: .blend, .glb, .fbx, the take and a preview, of which the first is called
preview.png.
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
    report_path = args.output / "report.json"
    if not report_path.is_file():
        return code
    report = json.loads(report_path.read_text(encoding="utf-8"))
    entries = report["inputs"]
    entries[0]["files"] = [_plainly_named(args.output, name) for name in entries[0]["files"]]
    report_path.write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    for name in (name for entry in entries for name in entry["files"]):
        print(f"  {args.output / name}")
    return code


def _plainly_named(folder: Path, name: str) -> str:
    """The preview becomes preview.png; other files keep their names."""
    if not name.endswith(".preview.png"):
        return name
    (folder / name).replace(folder / "preview.png")
    return "preview.png"


if __name__ == "__main__":
    sys.exit(main())
