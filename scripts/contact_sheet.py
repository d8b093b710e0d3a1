"""One picture that shows how well takes fit: per take a row of frames, each beside its fitted hand.

python scripts/contact_sheet.py TAKE_OR_RESULT_FOLDER [...] -o sheet.png [--frames 4]
blender -b -P scripts/contact_sheet.py -- TAKE_OR_RESULT_FOLDER [...] -o sheet.png
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np

from handfit_core.errors import HandfitError, InputError
from handfit_core.take import Take

_GAP = 4
"""pixels between cells"""
_BACKGROUND = 0.08


def main(argv: Sequence[str] | None = None) -> int:
    """Write the sheet; returns the exit code."""
    if argv is None:
        argv = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(
        prog="contact_sheet.py", description="One picture of how well takes fit."
    )
    parser.add_argument("takes", nargs="+", type=Path, metavar="TAKE", help="takes, or folders of them")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SHEET.png")
    parser.add_argument("--frames", type=int, default=4, metavar="N", help="frames per take (default: 4)")
    parser.add_argument(
        "--height", type=int, default=240, metavar="PX", help="height of a row (default: 240)"
    )
    parser.add_argument(
        "--turned", type=float, metavar="DEG", help="show the hands also from DEG degrees to the right"
    )
    args = parser.parse_args(argv)
    if importlib.util.find_spec("bpy") is None:
        print("error: this Python has no bpy: run it with 'blender -b -P', or install bpy", file=sys.stderr)
        return 1
    try:
        from blender_manient.scene.preview import write_png

        rows = [
            row(take, args.frames, args.height, args.turned)
            for path in args.takes
            for take in find_takes(path)
        ]
        write_png(stacked(rows), args.output)
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{args.output}: {len(rows)} takes")
    return 0


def find_takes(path: Path) -> list[Take]:
    """The take of a file, or all takes below a folder, by name. Raises InputError and TakeError."""
    if not path.is_dir():
        return [Take.load(path)]
    found = sorted(path.rglob("*.take.npz"))
    if not found:
        raise InputError(f"{path}: no takes (*.take.npz) in this folder")
    return [Take.load(p) for p in found]


def row(take: Take, count: int, height: int, turned: float | None = None) -> np.ndarray:
    """Up to `count` frames of a take side by side: (height, W, 3) of sRGB values 0..1. With `turned`, each
    also as seen from so many degrees to the right."""
    import bpy

    from blender_manient.scene.build import build_take
    from blender_manient.scene.preview import preview_rows, spread_frames, turned_rows

    bpy.ops.wm.read_factory_settings(use_empty=True)
    built = build_take(take, picture=False, render_setup=False)
    frames = spread_frames(take, max(1, count))
    views = preview_rows(built, take, frames)
    if turned is not None:
        seen = zip(views, turned_rows(built, take, frames, turned), strict=True)
        views = [np.concatenate(pair, axis=1) for pair in seen]
    cells = [_shrunk(rows, height) for rows in views]
    gap = np.full((height, _GAP, 3), _BACKGROUND)
    return np.concatenate([part for cell in cells for part in (cell, gap)], axis=1)


def stacked(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of different widths under each other."""
    width = max(r.shape[1] for r in rows)
    sheet = [
        np.pad(r, ((0, _GAP), (0, width - r.shape[1]), (0, 0)), constant_values=_BACKGROUND) for r in rows
    ]
    return np.concatenate(sheet, axis=0)


def _shrunk(rows: np.ndarray, height: int) -> np.ndarray:
    """Resample (H, W, 3) to a height by averaging areas (or repeating pixels, to enlarge)."""
    width = max(1, round(rows.shape[1] * height / rows.shape[0]))
    return _along(_along(rows, height, 0), width, 1)


def _along(values: np.ndarray, size: int, axis: int) -> np.ndarray:
    # The running sum, read off at fractional places: exact area averages in two lines.
    values = np.moveaxis(values, axis, 0)
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0, dtype=np.float64)])
    places = np.linspace(0, len(values), size + 1)
    low = np.minimum(places.astype(int), len(values) - 1)
    share = (places - low).reshape(-1, *([1] * (values.ndim - 1)))
    at = total[low] * (1 - share) + total[low + 1] * share
    return np.moveaxis(np.diff(at, axis=0) / (len(values) / size), 0, axis)


if __name__ == "__main__":
    sys.exit(main())
