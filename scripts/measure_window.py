#!/usr/bin/env python3
"""How freely Blender's window draws while a Rigify character follows live, beside a timer that only redraws.

    sudo HANDFIT_BLENDER_CHROOT=DIR HANDFIT_PYTHON=PYTHON python scripts/measure_window.py CLIP

DIR is from make_blender_chroot.sh; PYTHON has the core's requirements. Both are measured in turns in one
window, which plays the clip of a right hand as a camera; figures are medians of the rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.window.blender_window import BlenderWindow


def main(argv: list[str] | None = None) -> int:
    """Measure as the arguments say; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("clip", type=Path, metavar="CLIP")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="default: 3")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="of each; default: 10")
    args = parser.parse_args(argv)
    chroot = os.environ.get("HANDFIT_BLENDER_CHROOT")
    if not chroot:
        parser.error("HANDFIT_BLENDER_CHROOT must name a Blender chroot")
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept)
        clip, figures = folder / args.clip.name, folder / "figures.json"
        clip.write_bytes(args.clip.read_bytes())
        window = BlenderWindow(chroot, folder / "run", folder / "shots", (640, 480), reachable=folder)
        try:
            window.play(
                "live.measured",
                timeout=120.0 + 4.0 * args.rounds * args.seconds,
                source=clip,
                figures=figures,
                rounds=args.rounds,
                seconds=args.seconds,
            )
        finally:
            window.stop()
        for name, rows in json.loads(figures.read_text(encoding="utf-8")).items():
            print(
                f"{name:<24}",
                *(f"{key} {statistics.median(row[key] for row in rows):7.1f}" for key in rows[0]),
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
