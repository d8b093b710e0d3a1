"""The picture with its hands over it: skeletons, tags with side and certainty, boxes, buttons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import gpu
import numpy as np

from handfit_core.geometry.picture_map import mapped

from ..keypoint_mode.drawing import (
    DARK,
    DOUBT_COLOR,
    LINE_COLORS,
    LINES,
    PIN_COLOR,
    WRIST_COLOR,
    draw_tag,
    fill_box,
    frame_box,
    tag_box,
)
from ..screen import Box, draw_shape, draw_texture, ui_scale
from ..section import wrapped
from .choice import FoundHand, PictureView

CHOSEN_COLOR: Final = (0.10, 0.38, 0.80)
LEFT_OUT_COLOR: Final = (0.78, 0.78, 0.78)
STRIP_HEIGHT: Final = 34.0
"""pixels, at a user interface scale of 1, of the strips over and under the picture"""
SMALL: Final = 60.0
"""pixels of the region, at a user interface scale of 1: the lines of smaller hands are thinner"""


Name = tuple[str, str]
"""of a button, and what stands on it"""


@dataclass(frozen=True)
class Button:
    """A text to click on."""

    name: str
    """What is done"""
    text: str
    box: Box
    hand: FoundHand | None = None
    """Whose side it is"""

    def holds(self, x: float, y: float) -> bool:
        """Whether a place in pixels of the region lies on it."""
        return self.box[0] <= x < self.box[2] and self.box[1] <= y < self.box[3]


@dataclass(frozen=True, eq=False)
class Scene:
    """What is to be drawn."""

    texture: gpu.types.GPUTexture | None
    picture_view: PictureView | None
    free: Box
    """What nothing lies over, pixels of the region"""
    hands: Sequence[FoundHand]
    hovered: FoundHand | None
    buttons: Sequence[Button]
    pressed: str
    """Name of the button under the mouse"""
    boxes: Sequence[tuple[np.ndarray, str]]
    """Corners (2, 2) in the picture, and what is said of each"""
    text: str
    warning: bool


def picture_room(free: Box) -> Box:
    """Where the whole picture fits in: between the strips."""
    high = STRIP_HEIGHT * ui_scale()
    return (free[0], free[1] + high, free[2], free[3] - high)


def side_tags(hands: Sequence[FoundHand], matrix: np.ndarray, free: Box) -> list[Button]:
    """A tag over each hand: its side, and how sure it is that it is one."""
    scale, tags = ui_scale(), []
    for hand in hands:
        places = mapped(matrix, hand.points)
        text = f"{hand.side[0].upper()}  {hand.certainty:.0%}"
        left, top = places[:, 0].min(), places[:, 1].max() + 8.0 * scale
        box = tag_box(text, left, top, scale)
        if box[3] > free[3]:
            box = tag_box(text, left, places[:, 1].min() - 28.0 * scale, scale)
        tags.append(Button("side", text, box, hand))
    return tags


def row_of(left: Name | None, middle: Name, right: Name | None, free: Box) -> list[Button]:
    """Buttons beside each other in the lower strip: `middle` lies in its middle whatever lies beside it."""
    scale = ui_scale()

    def button(name: Name, x: float) -> Button:
        return Button(name[0], name[1], tag_box(f"   {name[1]}   ", x, free[1] + 2.0 * scale, 1.2 * scale))

    def width(name: Name) -> float:
        box = button(name, 0.0).box
        return box[2] - box[0]

    found = [button(middle, (free[0] + free[2] - width(middle)) / 2.0)]
    box, gap = found[0].box, 8.0 * scale
    found += [button(left, box[0] - gap - width(left))] if left is not None else []
    return found + ([button(right, box[2] + gap)] if right is not None else [])


def draw(scene: Scene, size: tuple[int, int]) -> None:
    """Draw over the current region of that size."""
    scale = ui_scale()
    gpu.state.blend_set("ALPHA")
    try:
        fill_box((0.0, 0.0, *size), (*DARK, 1.0))
        if scene.picture_view is not None:
            matrix = scene.picture_view.matrix(picture_room(scene.free))
            corners = mapped(
                matrix, np.array([[0.0, scene.picture_view.size[1]], [scene.picture_view.size[0], 0.0]])
            )
            if scene.texture is not None:
                draw_texture(scene.texture, tuple(corners.ravel().tolist()))
            _draw_hands(scene, matrix, scale)
            for ends, said in scene.boxes:
                low, high = np.sort(mapped(matrix, ends), axis=0)
                frame_box((*low, *high), (*DARK, 0.9), 4.0 * scale)
                frame_box((*low, *high), (*PIN_COLOR, 1.0), 1.5 * scale)
                if said:
                    box = tag_box(said, low[0], high[1] + 4.0 * scale, scale)
                    draw_tag(said, box, (*DARK, 0.85), PIN_COLOR, scale)
        for button in scene.buttons:
            _draw_button(button, scene, scale)
        if scene.text:
            left, _, right, top = scene.free
            tag_box("", left, top, scale)
            for number, line in enumerate(wrapped(scene.text, right - left - 12.0 * scale)):
                box = tag_box(line, left, top - (26.0 + 20.0 * number) * scale, scale)
                draw_tag(line, box, (*DARK, 0.85), DOUBT_COLOR if scene.warning else WRIST_COLOR, scale)
    finally:
        gpu.state.blend_set("NONE")


def _draw_hands(scene: Scene, matrix: np.ndarray, scale: float) -> None:
    for small in (False, True):
        lines: list[np.ndarray] = []
        colors: list[np.ndarray] = []
        for hand in scene.hands:
            places = mapped(matrix, hand.points)
            if (np.ptp(places, axis=0).max() < SMALL * scale) != small:
                continue
            lines.append(places[LINES].reshape(-1, 2))
            color = LINE_COLORS.copy() if hand.chosen else np.full_like(LINE_COLORS, 0.8)
            if not hand.chosen:
                color[:, :3] = PIN_COLOR if hand is scene.hovered else LEFT_OUT_COLOR
            color[:, 3] = 1.0
            colors.append(color.repeat(2, axis=0))
        if lines:
            width, ends = (1.2 if small else 2.2) * scale, np.concatenate(lines)
            dark = np.tile((*DARK, 0.75), (len(ends), 1))
            draw_shape("LINES", ends, dark, width + (1.2 if small else 2.5) * scale)
            draw_shape("LINES", ends, np.concatenate(colors), width)
    for hand in scene.hands:
        if hand.chosen or hand is scene.hovered:
            places = mapped(matrix, hand.points)
            margin = 6.0 * scale
            box = (*(places.min(axis=0) - margin), *(places.max(axis=0) + margin))
            shade = PIN_COLOR if hand is scene.hovered else CHOSEN_COLOR
            frame_box(box, (*DARK, 0.6), 3.5 * scale)
            frame_box(box, (*shade, 1.0), 1.8 * scale)


def _draw_button(button: Button, scene: Scene, scale: float) -> None:
    hand = button.hand
    under = button.name == scene.pressed and hand in (None, scene.hovered)
    strong = button.name in ("capture", "add") if hand is None else hand.chosen
    fill, shade = np.array(CHOSEN_COLOR if strong else DARK), PIN_COLOR if strong or under else LEFT_OUT_COLOR
    if hand is None:
        draw_tag(f"   {button.text}   ", button.box, (*(fill + 0.15 * under), 1.0), shade, 1.2 * scale)
    else:
        draw_tag(button.text, button.box, (*(fill + 0.15 * under), 1.0), shade, scale)
    if hand is None or under:
        frame_box(button.box, (*shade, 0.6), scale)
