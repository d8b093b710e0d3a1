"""How far a captured hand is from the picture over time: a graph along the bottom of the time editors.

It is drawn from the take that the hand keeps, with the frames where those editors have them. A curve in the
hand's own action would be in the way of animating: a few percent or a hundred pixels beside rotations of
one make *View All* useless for either.
"""

from __future__ import annotations

from typing import Final

import blf
import bpy
import gpu
import numpy as np

from ..common import screen
from ..scene.confidence import Errors, colors_of, errors_of
from ..scene.store import CapturedHand, captured_hands, hand_of, rows_at, scene_frames

_HEIGHT: Final = (18.0, 64.0)
"""least and most pixels of a hand's graph, at a user interface scale of 1"""
_BELOW: Final = 14.0
"""pixels under the graph at scale 1, for the scroll bar"""
_ABOVE: Final = 26.0
"""pixels over the graph at scale 1, for the frame numbers"""
_SPACES: Final = {"GRAPH_EDITOR": "SpaceGraphEditor", "DOPESHEET_EDITOR": "SpaceDopeSheetEditor"}
"""Area type -> class; the Timeline is a Dope Sheet"""

_handles: dict[str, object] = {}


def segments(
    frames: np.ndarray, errors: np.ndarray, span: tuple[float, float], size: tuple[float, float], most: float
) -> tuple[np.ndarray, np.ndarray]:
    """The graph's lines: (N, 2, 2) pixels from its lower left corner, and (N, 2) errors at their ends.

    `frames` (T,) and `errors` (T,), NaN where there is none: no line leads there. `span`: first and last
    visible frame; `size`: width and height in pixels, of which the full height stands for the error `most`.
    """
    x = (frames - span[0]) / ((span[1] - span[0]) or 1.0) * size[0]
    y = errors / most * size[1]
    points = np.stack([x, y], axis=-1)
    ends = np.stack([points[:-1], points[1:]], axis=1)
    values = np.stack([errors[:-1], errors[1:]], axis=-1)
    seen = np.isfinite(values).all(axis=1) & (ends[:, 1, 0] >= 0.0) & (ends[:, 0, 0] <= size[0])
    return ends[seen], values[seen]


def label(hand: CapturedHand, errors: Errors, frame: float) -> str:
    """What is written over the graph: the error at a scene frame and the largest one."""
    row = int(rows_at(hand.collection, hand.take, np.array([frame]))[0])
    title, said, most = errors.scale.title.lower(), errors.scale.said, float(np.nanmax(errors.frames))
    here = "" if row < 0 or np.isnan(errors.frames[row]) else f"{said(errors.frames[row])} here, "
    return f"{hand.armature.name}: {title} {here}{said(most)} at most"


def shown_hands(scene: bpy.types.Scene) -> list[CapturedHand]:
    """The hands whose graph is switched on, by name, and that have anything to show."""
    found = [hand_of(o) for o in captured_hands(scene, shown=True) if o.manient.show_error]
    return [hand for hand in found if hand is not None and errors_of(hand).mean is not None]


def shown_changed(*_: object) -> None:
    """Draw the time editors again, with graphs or without."""
    _follow()
    screen.redraw(*_SPACES)


def _draw() -> None:
    context = bpy.context
    scene, region, space = context.scene, context.region, context.space_data
    if scene is None or region is None or getattr(space, "mode", "") == "DRIVERS":
        return
    hands = shown_hands(scene)
    if not hands:
        return
    scale = screen.ui_scale()
    span = region.view2d.region_to_view(0, 0)[0], region.view2d.region_to_view(region.width, 0)[0]
    room = (region.height - (_BELOW + _ABOVE) * scale) / len(hands)
    height = min(max(room, _HEIGHT[0] * scale), _HEIGHT[1] * scale)
    gpu.state.blend_set("ALPHA")
    try:
        for number, hand in enumerate(hands):
            low = _BELOW * scale + number * (height + 2.0 * scale)
            _draw_one(hand, scene.frame_current_final, span, (region.width, height), low, scale)
    finally:
        gpu.state.blend_set("NONE")


def _draw_one(
    hand: CapturedHand,
    frame: float,
    span: tuple[float, float],
    size: tuple[float, float],
    low: float,
    scale: float,
) -> None:
    width, height = size
    errors, levels = errors_of(hand), errors_of(hand).scale.levels
    most = float(np.nanmax(np.append(errors.frames, levels[-1])))
    frames = scene_frames(hand.collection, hand.take)
    _rectangle((0.0, low, width, low + height), (0.0, 0.0, 0.0, 0.45))
    fair = low + height * errors.scale.fair_below / most
    _rectangle((0.0, fair, width, fair + scale), (1.0, 1.0, 1.0, 0.15))
    ends, values = segments(frames, errors.frames, span, size, most)
    if len(ends):
        colors = np.pad(colors_of(values.reshape(-1), levels), ((0, 0), (0, 1)), constant_values=1.0)
        screen.draw_shape("LINES", ends.reshape(-1, 2) + np.array((0.0, low)), colors, 2.0 * scale)
    blf.size(0, 11.0 * scale)
    blf.color(0, 0.92, 0.92, 0.92, 1.0)
    blf.position(0, 8.0 * scale, low + height - 13.0 * scale, 0.0)
    blf.draw(0, label(hand, errors, frame))


def _rectangle(corners: tuple[float, float, float, float], color: tuple[float, ...]) -> None:
    left, bottom, right, top = corners
    points = np.array([(left, bottom), (right, bottom), (left, top), (right, top)])
    screen.draw_shape("TRI_STRIP", points, np.tile(color, (4, 1)))


def _draw_in_editors(wanted: bool) -> None:
    """Draw in all time editors, or in none: every redraw of theirs looks for hands in the whole scene."""
    if wanted and not _handles:
        for name in _SPACES.values():
            _handles[name] = getattr(bpy.types, name).draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")
    elif not wanted:
        for name, handle in _handles.items():
            getattr(bpy.types, name).draw_handler_remove(handle, "WINDOW")
        _handles.clear()


def _follow(*_args) -> None:
    """Draw as long as some hand shows its graph, and no longer."""
    _draw_in_editors(any(o.manient.is_hand and o.manient.show_error for o in bpy.data.objects))


HANDLERS: Final = dict.fromkeys(("load_post", "undo_post", "redo_post", "blend_import_post"), _follow)
"""Events after which another hand may show its graph"""
LISTENERS: Final = {"error": shown_changed}


def unregister() -> None:
    """Draw no more."""
    _draw_in_editors(False)
