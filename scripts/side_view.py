#!/usr/bin/env python3
"""A small moving picture of how takes of one clip sit in depth: their hands from the side, beside each other.

    python scripts/side_view.py before=A.take.npz after=B.take.npz -o view.webp --frames 165-230

Runs where bpy and OpenCV are installed. Each take is seen from a place of its own that does not move, as far
to the side of its hands as `--turned` says; the line goes through where the wrist is on average.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import math

import cv2
import numpy as np

from handfit_core.errors import HandfitError
from handfit_core.files import written_whole
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import axes
from handfit_core.take import Take

if TYPE_CHECKING:
    import bpy

    from blender_manient.scene.build import BuiltTake

_AROUND: Final = 0.18
"""metres from the hands' middle to the edge of what is shown"""
_LONGEST: Final = 720
"""pixels of what is rendered"""
_QUALITY: Final = 60
"""of WebP, 1 to 100"""


def main(argv: Sequence[str] | None = None) -> int:
    """Write the moving picture; returns the exit code."""
    parser = argparse.ArgumentParser(prog="side_view.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("takes", nargs="+", metavar="NAME=TAKE", help="what stands over a take, and its file")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="VIEW.webp")
    parser.add_argument("--frames", required=True, metavar="FIRST-LAST", help="of the clip")
    parser.add_argument("--every", type=int, default=2, metavar="N", help="so many frames on (default: 2)")
    parser.add_argument(
        "--turned", type=float, default=75.0, metavar="DEG", help="to the right (default: 75)"
    )
    parser.add_argument("--size", type=int, default=320, metavar="PX", help="of each take (default: 320)")
    args = parser.parse_args(argv)
    if importlib.util.find_spec("bpy") is None:
        print("error: this Python has no bpy: install it", file=sys.stderr)
        return 1
    try:
        first, last = (int(end) for end in args.frames.split("-"))
        cells, fps = [], 25.0
        for named in args.takes:
            name, path = named.split("=", 1)
            take = Take.load(Path(path))
            fps = take.fps
            cells.append(_cells(take, name, range(first, last + 1, args.every), args.turned, args.size))
        animation = cv2.Animation()
        animation.frames = [np.concatenate(pair, axis=1) for pair in zip(*cells, strict=True)]
        animation.durations = [round(1000 * args.every / fps)] * len(animation.frames)
        with written_whole(args.output) as beside:
            cv2.imwriteanimation(str(beside), animation, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{args.output}: {len(animation.frames)} frames, {args.output.stat().st_size} bytes")
    return 0


def _cells(take: Take, name: str, frames: Sequence[int], degrees: float, side: int) -> list[np.ndarray]:
    """(side, side, 3) uint8 BGR of each frame: what lies around the hands' middle, of one size in all."""
    import bpy

    from blender_manient.scene.build import build_take

    bpy.ops.wm.read_factory_settings(use_empty=True)
    built = build_take(take, picture=False, render_setup=False)
    rows = np.searchsorted(take.frame_numbers, frames)
    joints = np.concatenate([t.joints_3d[rows[t.present[rows]]] for t in take.hands])
    middle = joints.mean(axis=(0, 1))
    turn = rotvec_to_rotmat(np.array([0.0, np.radians(degrees), 0.0]))
    wrist = turn @ (joints[:, 0].mean(axis=0) - middle)
    views = turned_rows(built, take, frames, degrees, still=True)
    scale = views[0].shape[0] / take.height
    x, y = scale * take.intrinsics.project(middle[None])[0]
    half = scale * _AROUND * take.intrinsics.fx / middle[2]
    # From pixels of the rows to those of the cell.
    zoom = side / (2.0 * half)
    into = np.array([[zoom, 0.0, side / 2 - zoom * x], [0.0, zoom, side / 2 - zoom * y]])
    line = round(side / 2 + zoom * scale * take.intrinsics.fx * wrist[0] / (middle[2] + wrist[2]))
    cells = []
    for view in views:
        picture = np.ascontiguousarray(np.round(255.0 * view[..., ::-1]).astype(np.uint8))
        background = picture[0, 0].tolist()
        cell = cv2.warpAffine(picture, into, (side, side), flags=cv2.INTER_AREA, borderValue=background)
        cv2.line(cell, (line, 0), (line, side), (120, 120, 120), 1, cv2.LINE_AA)
        cv2.putText(cell, name, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (230, 230, 230), 1, cv2.LINE_AA)
        cells.append(cell)
    return cells


def turned_rows(
    built: BuiltTake,
    take: Take,
    frames: Sequence[int],
    degrees: float,
    *,
    still: bool = False,
    longest: int = _LONGEST,
) -> list[np.ndarray]:
    """The hands of several frames alone, from the camera after it went round them by `degrees` to its right:
    rows (H, W, 3) of sRGB values 0..1. What fits the picture may still be wrong in depth: here it shows.

    `still`: one place for all frames, so that what moves in the rows is the hands. `longest`: pixels of a
    view's longer side."""
    from blender_manient.scene.preview import MISSING, remove_with_data, render_hands

    scale = min(1.0, longest / max(take.width, take.height))
    views = []
    for frame in frames:
        camera = _turned_camera(built, take, frames if still else [frame], degrees)
        try:
            hands = render_hands(built, take, frame, scale, camera)
        finally:
            remove_with_data(camera)
        views.append(hands[..., :3] * hands[..., 3:] + np.array(MISSING) * (1 - hands[..., 3:]))
    return views


def _turned_camera(built: BuiltTake, take: Take, frames: Sequence[int], degrees: float) -> bpy.types.Object:
    import bpy
    from mathutils import Matrix, Vector

    rows = np.searchsorted(take.frame_numbers, frames)
    joints = [track.joints_3d[row] for row in rows for track in take.hands if track.present[row]]
    centre = Vector(axes.points_to_world(np.concatenate(joints).mean(axis=0)).tolist())
    own = built.camera.matrix_world
    about_up = Matrix.Rotation(math.radians(degrees), 4, own.to_3x3() @ Vector((0.0, 1.0, 0.0)))
    camera = bpy.data.objects.new("turned", built.camera.data.copy())
    camera.data.show_background_images = False
    camera.matrix_world = Matrix.Translation(centre) @ about_up @ Matrix.Translation(-centre) @ own
    return camera


if __name__ == "__main__":
    sys.exit(main())
