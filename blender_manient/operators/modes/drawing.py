"""What modes draw in a region: lines of text, boxes, and the 21 points of a hand with its skeleton."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import blf
import gpu
import numpy as np

from handfit_core.common.skeleton import FINGERS, KEYPOINT_PARENTS, NUM_KEYPOINTS, PALM_KEYPOINTS

from ...common.screen import Box, draw_shape, ui_scale

FINGER_COLORS: Final = {
    "thumb": (1.00, 0.42, 0.33),
    "index": (1.00, 0.76, 0.20),
    "middle": (0.45, 0.88, 0.36),
    "ring": (0.28, 0.72, 1.00),
    "little": (0.78, 0.50, 1.00),
}
WRIST_COLOR: Final = (0.92, 0.92, 0.92)
PIN_COLOR: Final = (1.0, 1.0, 1.0)
DARK: Final = (0.05, 0.05, 0.05)
DOUBT_COLOR: Final = (1.0, 0.55, 0.15)

TEXT_SIZE: Final = 13.0
"""The size of text in points, at a user interface scale of 1"""
RADIUS: Final = 5.0
"""The radius in pixels of a handle that no other crowds, at a user interface scale of 1"""
_LEAST_RADIUS: Final = 1.5
"""The radius in pixels of a handle that others nearly cover, at a user interface scale of 1"""
_RIM: Final = 1.5
"""The width in pixels of the dark edge around a handle, at a user interface scale of 1"""
_ACTIVE, _PINNED = 1.35, 2.1
"""How much larger a handle is under the mouse, and how much a pin is"""
_LINE: Final = 2.0
"""The width in pixels of a bone of a hand with room for its handles, at a user interface scale of 1"""

_PARTS: Final = {
    "thumb": ("Base", "Knuckle", "Joint", "Tip"),
    "other": ("Knuckle", "Middle Joint", "End Joint", "Tip"),
}


def title(keypoint: int) -> str:
    """Return an artist's name of a keypoint, such as `Index Tip`."""
    if keypoint == 0:
        return "Wrist"
    finger, part = FINGERS[(keypoint - 1) // 4], (keypoint - 1) % 4
    return f"{finger.capitalize()} {_PARTS.get(finger, _PARTS['other'])[part]}"


def color(keypoint: int) -> tuple[float, float, float]:
    """Return a keypoint's colour, which is its finger's."""
    return WRIST_COLOR if keypoint == 0 else FINGER_COLORS[FINGERS[(keypoint - 1) // 4]]


@dataclass(frozen=True, eq=False)
class Picture:
    """A hand's points in the region, and the line of text above them."""

    places: np.ndarray
    """(21, 2) pixels of the region where the points are; NaN: not drawn"""
    pinned: frozenset[int]
    hovered: int | None
    dragged: int | None
    text: str
    """The line of text at the top of the picture"""
    warning: bool
    """True if the line is a warning"""
    corner: tuple[float, float]
    """Pixels of the region, x and y, where the line of text begins"""
    hollow: bool = False
    """True if the points are detections and not where the hand is"""


def draw(picture: Picture) -> None:
    """Draw the points and the line in the current region."""
    scale = ui_scale()
    sizes = handle_sizes(picture, scale)
    ends = picture.places[LINES]  # (20, 2, 2)
    there = np.isfinite(ends).all(axis=(1, 2))
    with blended():
        if there.any():
            width = max(_LINE * float(np.nanmedian(sizes)), 1.0) * scale
            draw_shape("LINES", ends[there].reshape(-1, 2), np.repeat(LINE_COLORS[there], 2, axis=0), width)
        _draw_handles(picture, sizes, scale)
    named = picture.dragged if picture.dragged is not None else picture.hovered
    if named is not None and np.isfinite(picture.places[named]).all():
        pinned = "  (pinned)" if named in picture.pinned and picture.dragged is None else ""
        x, y = picture.places[named] + (RADIUS + 8.0) * scale
        write(title(named) + pinned, x, y, PIN_COLOR, scale)
    if picture.text:
        shade = DOUBT_COLOR if picture.warning else WRIST_COLOR
        write(picture.text, *picture.corner, shade, scale)


@contextlib.contextmanager
def blended() -> Iterator[None]:
    """Mix colours with what is there by their alpha."""
    gpu.state.blend_set("ALPHA")
    try:
        yield
    finally:
        gpu.state.blend_set("NONE")


def half_gaps(places: np.ndarray) -> np.ndarray:
    """Return (21,) pixels to half-way from each of `places` (21, 2) to the nearest other one; infinite for a
    place alone, and NaN for one that is NaN."""
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    apart[np.isnan(apart)] = np.inf
    np.fill_diagonal(apart, np.inf)
    return np.where(np.isnan(places).any(axis=1), np.nan, apart.min(axis=1) / 2.0)


def handle_sizes(picture: Picture, scale: float) -> np.ndarray:
    """Return (21,) each handle's size relative to one that has room: as large as lets no two cover each
    other, where they are not in the same place."""
    radius = np.full(NUM_KEYPOINTS, RADIUS)
    radius[[k for k in (picture.hovered, picture.dragged) if k is not None]] *= _ACTIVE
    outer = radius + _RIM
    outer[list(picture.pinned)] = radius[list(picture.pinned)] * _PINNED
    return np.clip(half_gaps(picture.places) / (outer * scale), _LEAST_RADIUS / RADIUS, 1.0)


def _draw_handles(picture: Picture, sizes: np.ndarray, scale: float) -> None:
    """Draw the handles as discs or rings, and those of pins as diamonds in a white frame."""
    corners: list[np.ndarray] = []
    colors: list[np.ndarray] = []
    for keypoint in np.flatnonzero(np.isfinite(picture.places).all(axis=1)).tolist():
        active, size = keypoint in (picture.hovered, picture.dragged), sizes[keypoint] * scale
        radius, own = RADIUS * size * (_ACTIVE if active else 1.0), (*color(keypoint), 1.0)
        if keypoint in picture.pinned:
            rings = [(radius * _PINNED, (*DARK, 0.9)), (radius * 1.8, (*PIN_COLOR, 1.0)), (radius * 1.1, own)]
        else:
            rings = [(radius + _RIM * size, (*DARK, 0.8)), (radius, (*PIN_COLOR, 1.0) if active else own)]
        fan = _DIAMOND if keypoint in picture.pinned else _RING if picture.hollow else _DISC
        for extent, shade in rings:
            corners.append(picture.places[keypoint] + extent * fan)
            colors.append(np.tile(shade, (len(fan), 1)))
    if corners:
        draw_shape("TRIS", np.concatenate(corners), np.concatenate(colors))


def write(text: str, x: float, y: float, shade: tuple[float, ...], scale: float) -> None:
    """Write a line in the current region, its lower left at (x, y) pixels."""
    font = 0
    blf.size(font, TEXT_SIZE * scale)
    blf.enable(font, blf.SHADOW)
    blf.shadow(font, 5, 0.0, 0.0, 0.0, 0.9)
    blf.shadow_offset(font, 1, -1)
    blf.color(font, *shade, 1.0)
    blf.position(font, x, y, 0.0)
    blf.draw(font, text)
    blf.disable(font, blf.SHADOW)


def tag_box(text: str, x: float, y: float, scale: float) -> Box:
    """Return the box of a tag with that text, whose lower left is at (x, y) pixels of the region. Sets the
    font's size."""
    blf.size(0, TEXT_SIZE * scale)
    return (x, y, x + blf.dimensions(0, text)[0] + 12.0 * scale, y + 20.0 * scale)


def draw_tag(text: str, box: Box, fill: tuple[float, ...], shade: tuple[float, ...], scale: float) -> None:
    """Draw a tag: a text on a ground of its own, which is read over any picture."""
    fill_box(box, fill)
    write(text, box[0] + 6.0 * scale, box[1] + 5.5 * scale, shade, scale)
    gpu.state.blend_set("ALPHA")  # which writing ends


def fill_box(box: Box, fill: tuple[float, ...]) -> None:
    """Fill a box of the region with a colour and its alpha."""
    draw_shape("TRIS", _corners(box, 0, 1, 2, 0, 2, 3), np.tile(fill, (6, 1)))


def frame_box(box: Box, shade: tuple[float, ...], width: float) -> None:
    """Draw the edges of a box of the region."""
    draw_shape("LINES", _corners(box, 0, 1, 1, 2, 2, 3, 3, 0), np.tile(shade, (8, 1)), width)


def _corners(box: Box, *order: int) -> np.ndarray:
    left, bottom, right, top = box
    return np.array([(left, bottom), (right, bottom), (right, top), (left, top)])[list(order)]


def _fan(sides: int) -> np.ndarray:
    """Return (3 sides, 2), the corners of the triangles of a regular polygon about 0, the first corner on
    top."""
    angles = np.pi / 2 + np.arange(sides + 1) * (2 * np.pi / sides)
    outline = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.stack([np.zeros((sides, 2)), outline[:-1], outline[1:]], axis=1).reshape(-1, 2)


def _ring(sides: int) -> np.ndarray:
    """Return (6 sides, 2), the corners of the triangles of a regular polygon about 0 with a hole in its
    middle."""
    outline = _fan(sides).reshape(-1, 3, 2)[:, 1:]  # (sides, 2, 2)
    outer, inner = outline, outline * _HOLE
    corners = [outer[:, 0], outer[:, 1], inner[:, 0], inner[:, 0], outer[:, 1], inner[:, 1]]
    return np.stack(corners, axis=1).reshape(-1, 2)


_HOLE: Final = 0.62
"""The radius of a hollow handle's hole, over the handle's"""
_DISC: Final = _fan(20)
_RING: Final = _ring(20)
_DIAMOND: Final = _fan(4)
LINES: Final = np.array([(KEYPOINT_PARENTS[k], k) for k in range(1, NUM_KEYPOINTS)])
# The palm's lines stay behind: there are five from the wrist.
LINE_COLORS: Final = np.array(
    [(*color(k), 0.45 if k in PALM_KEYPOINTS else 0.85) for k in range(1, NUM_KEYPOINTS)], dtype=np.float32
)
