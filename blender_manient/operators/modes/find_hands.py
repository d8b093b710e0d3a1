"""Find Hands: the worker finds all hands of one picture, which is drawn with them; clicks choose, boxes are
searched.

Nothing of the file is touched: the picture is a texture that the worker wrote for it, and what is chosen
becomes options of a capture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import bpy
import gpu
import numpy as np

from handfit_core.capturing.options import CaptureOptions, region_of
from handfit_core.common.arrays import pack
from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import other_side
from handfit_core.detect.detector import Region
from handfit_core.geometry.picture_map import mapped
from handfit_core.media.frame_range import FrameRange

from ...common import screen
from ...common.screen import Box, draw_shape, ui_scale
from ...common.section import wrapped
from ...common.wording import capitalised, counted
from ...session import cache, jobs, shared_worker
from . import drawing, view
from .choice import FOUND_AGAIN, Choice, FoundHand
from .drawing import DARK, PIN_COLOR, draw_tag, frame_box, tag_box

REACH: Final = 14.0
"""Pixels from a point of a hand within which the mouse means that hand, at a user interface scale of 1"""
CLICK_PIXELS: Final = 6.0
"""Pixels, at a user interface scale of 1, that a press moves at least when it is no click"""
MIN_BOX_PIXELS: Final = 8.0
"""The least side of a box in pixels of the picture: in smaller boxes nobody sees a hand"""
CHOSEN_COLOR: Final = (0.10, 0.38, 0.80)
LEFT_OUT_COLOR: Final = (0.78, 0.78, 0.78)
STRIP_HEIGHT: Final = 34.0
"""The height in pixels, at a user interface scale of 1, of the strips over and under the picture"""
SMALL: Final = 60.0
"""Pixels of the region, at a user interface scale of 1: the lines of hands that are smaller are thinner"""
_KEYS = (
    "Click: Choose Hand    Click L or R: Other Side    Drag: Look in a Box    X: Throw Out    "
    "A: All or None    Wheel: Zoom    Middle Mouse: Move    Home: Whole Picture    Ctrl Z: Undo    "
    "Enter: Capture    Esc: Leave"
)
NOTHING_THERE: Final = (
    "No hand was found in the box: draw it closer around the hand, or over all of it, or lay a hand there "
    "yourself with Add Hand"
)

Name = tuple[str, str]
"""The name of a button, and what stands on it"""


class Source(NamedTuple):
    """The files, the frame and the options of a search for hands."""

    files: tuple[str, ...]
    frame: int | None
    """The number of the source's frame; None for a photo"""
    options: CaptureOptions

    def fields(self, box: tuple[float, ...] | None = None, picture: Path | None = None) -> dict[str, Any]:
        """Return the fields of a `find` request: for all hands, for the one in a box, or for the `picture`
        alone."""
        options = replace(
            self.options,
            frames=None if self.frame is None else FrameRange(self.frame, self.frame),
            regions=() if box is None else (region_of(box),),
            only_regions=box is not None or picture is not None,
        )
        fields = {"input": list(self.files), "options": options.to_message()}
        return fields if picture is None else {**fields, "picture": str(picture)}


@dataclass(frozen=True)
class Button:
    """A text in the region that can be clicked on."""

    name: str
    text: str
    box: Box
    hand: FoundHand | None = None
    """The hand whose side the button shows; None for a button of no hand."""

    def holds(self, x: float, y: float) -> bool:
        """True if a place in pixels of the region lies on it."""
        return self.box[0] <= x < self.box[2] and self.box[1] <= y < self.box[3]


class FindMode(view.Overlay):
    """The state of Find Hands, from its start to `end`."""

    keys: Final = _KEYS

    def __init__(self, source: Source, viewport: view.Viewport, source_path: str) -> None:
        """Ask the worker. `source_path`: what the panel names as the source now. Raises HandfitError."""
        self.source = source
        self.source_path = source_path
        self.choice = Choice()
        self.picture_view: view.PictureView | None = None
        self.message = ""
        self.hovered: FoundHand | None = None
        self.pressed = ""
        self.dragged: tuple[np.ndarray, np.ndarray] | None = None
        """(2,) pixels of the region each: where the mouse was pressed, and where it is; None while nothing is
        dragged"""
        self.nothing_there = False
        self._boxes: list[tuple[float, ...]] = []
        """Boxes (x, y, width, height) in pixels of the picture that were drawn and are not searched yet"""
        self._texture: gpu.types.GPUTexture | None = None
        self._picture = cache.temporary_take("picture").with_suffix(".jpg")
        self._asked: dict[shared_worker.Asking, tuple[float, ...] | None] = {}
        """By request, the box (x, y, width, height) in pixels of the picture that it searches; None: the
        whole picture"""
        self._showing = self._ask(picture=self._picture)
        self._finding = self._ask()
        super().__init__(viewport)

    def end(self, _context: bpy.types.Context) -> None:
        """Take the drawing away. May be called twice."""
        if self.remove():
            self._texture = None
            self._cancel_requests()
            self._picture.unlink(missing_ok=True)

    def trouble(self, context: bpy.types.Context) -> str | None:
        """Return why the mode cannot go on, in a sentence; None where it can."""
        if jobs.busy():
            return "Find Hands: a capture has begun"
        if self.viewport() is None:
            return "Find Hands: the viewport is gone"
        if context.scene is None or context.scene.manient.source != self.source_path:
            return "Find Hands: another source was chosen"
        return None

    # The worker

    @property
    def busy(self) -> bool:
        """True if the worker still searches."""
        return bool(self._asked)

    def tick(self, context: bpy.types.Context) -> None:
        """Take in what the worker has answered: the picture, the hands it found, and those in drawn boxes."""
        try:
            for asking, box in list(self._asked.items()):
                found = shared_worker.advance(asking)
                if found is None:
                    continue
                del self._asked[asking]
                if asking is self._showing:
                    self.picture_view = view.PictureView((found["width"], found["height"]))
                    self._texture = screen.texture_of(str(self._picture))
                elif box is None:
                    self.choice.show(found["hands"], context.scene.manient.hands)
                    self._search_boxes()
                else:
                    self.message, self.nothing_there = "", not found["hands"]
                    for hand in found["hands"]:
                        self.message = self.choice.add(FoundHand.of(hand, drawn=box))
                        self.nothing_there = self.message == FOUND_AGAIN
                screen.redraw("VIEW_3D")
        except (HandfitError, RuntimeError) as error:
            self._cancel_requests()
            self.message = capitalised(str(error).strip())
            screen.redraw("VIEW_3D")

    def _ask(self, box: tuple[float, ...] | None = None, picture: Path | None = None) -> shared_worker.Asking:
        known = [pack(hand.points.astype(np.float32)) for hand in self.choice.hands]
        asking = shared_worker.ask("find", "Find Hands", **self.source.fields(box, picture), known=known)
        next(asking)
        self._asked[asking] = box
        return asking

    def _cancel_requests(self) -> None:
        for asking in self._asked:
            asking.close()
        self._asked.clear()

    def search_box(self, corners: np.ndarray) -> None:
        """Have the worker detect a hand in a box with these corners (2, 2), pixels of the picture, once it
        has found all that it finds without one."""
        assert self.picture_view is not None
        low, high = np.clip(np.sort(corners, axis=0), 0.0, self.picture_view.size)
        if (high - low).min() < MIN_BOX_PIXELS:
            self.message = "The box is too small to show a hand: drag one around the whole hand"
            return
        self.message, self.nothing_there = "", False
        self._boxes.append((*low.tolist(), *(high - low).tolist()))
        if self._finding not in self._asked:
            self._search_boxes()

    def _search_boxes(self) -> None:
        while self._boxes:
            self._ask(self._boxes.pop(0))

    def regions(self) -> tuple[Region, ...]:
        """Return the chosen hands as the regions of a capture."""
        return self.choice.regions(self.source.frame)

    # The mouse

    def room(self, viewport: view.Viewport) -> Box:
        """Return the box, in pixels of the region, between the strips, in which the whole picture fits."""
        left, bottom, right, top = screen.free_box(viewport.area, viewport.region)
        high = STRIP_HEIGHT * ui_scale()
        return left, bottom + high, right, top - high

    def matrix(self, viewport: view.Viewport) -> np.ndarray:
        """Return the (3, 3) matrix from pixels of the picture, once there is one, to pixels of the region."""
        shown = self.picture_view
        return np.eye(3) if shown is None else shown.matrix(self.room(viewport))

    def picture_point(self, viewport: view.Viewport, mouse: np.ndarray) -> np.ndarray:
        """Return the place (2,) in pixels of the picture that lies at a place (2,) in pixels of the
        region."""
        return mapped(np.linalg.inv(self.matrix(viewport)), mouse)

    def hover(self, viewport: view.Viewport, mouse: np.ndarray) -> bool:
        """Take the mouse's place, (2,) pixels of the region; return whether that changes what is shown."""
        before = self.hovered, self.pressed
        button = next((b for b in reversed(self.buttons(viewport)) if b.holds(*mouse)), None)
        self.pressed = button.name if button is not None else ""
        self.hovered = button.hand if button is not None else None
        if button is None and self.picture_view is not None:
            place, scale = self.picture_point(viewport, mouse), self.picture_view.scale(self.room(viewport))
            self.hovered = self.choice.hand_at(place, scale, REACH * ui_scale())
        return before != (self.hovered, self.pressed)

    def release(self, viewport: view.Viewport) -> str:
        """End a drag, which searches its box, or a click on what the mouse is over; return the name of the
        button that the operator has to handle."""
        assert self.dragged is not None
        (start, stop), self.dragged = self.dragged, None
        if np.abs(stop - start).max() >= CLICK_PIXELS * ui_scale():
            if self.picture_view is not None:
                self.search_box(self.picture_point(viewport, np.array([start, stop])))
            return ""
        if self.pressed not in ("", "side"):
            return self.pressed
        if self.hovered is not None:
            self.message, self.nothing_there = "", False
            (self.choice.flip_side if self.pressed == "side" else self.choice.toggle)(self.hovered)
        return ""

    # Drawing

    def buttons(self, viewport: view.Viewport) -> list[Button]:
        """Return all buttons: the tags of the hands with their sides, and those in the lower strip."""
        free, count = screen.free_box(viewport.area, viewport.region), len(self.choice.chosen)
        matrix, scale, tags = self.matrix(viewport), ui_scale(), list[Button]()
        for hand in self.choice.hands if self.picture_view is not None else ():
            places = mapped(matrix, hand.points)
            text = f"{hand.side[0].upper()}  {hand.certainty:.0%}"
            box = tag_box(text, places[:, 0].min(), places[:, 1].max() + 8.0 * scale, scale)
            if box[3] > free[3]:
                box = tag_box(text, box[0], places[:, 1].min() - 28.0 * scale, scale)
            tags.append(Button("side", text, box, hand))
        capture = ("capture", f"Capture {counted(count, 'Hand')}") if count else None
        return tags + row_of(
            capture, ("leave", "Leave"), ("add", "Add Hand") if self.nothing_there else None, free
        )

    def status_line(self) -> tuple[str, bool]:
        """Return the line over the picture, and whether it is a warning."""
        if self.message:
            return self.message, True
        if self.hovered is not None:
            side, other = self.hovered.side.capitalize(), other_side(self.hovered.side)
            if self.pressed == "side":
                return f"{side} hand. Click: make it a {other} hand", False
            click = "leave it out" if self.hovered.chosen else "choose it"
            return f"{side} hand, {self.hovered.certainty:.0%} sure. Click: {click}. X: throw it out", False
        if self._finding in self._asked:
            return "Looking for hands ...", False
        if self.nothing_there:
            return NOTHING_THERE, True
        if not self.choice.hands:
            return "No hand was found: drag a box around one that you see", True
        where = "" if self.source.frame is None else f"Frame {self.source.frame}: "
        found, chosen = counted(len(self.choice.hands), "hand"), len(self.choice.chosen)
        return f"{where}{found} found, {chosen} chosen. Drag a box around a hand that is missing", False

    def draw(self, viewport: view.Viewport) -> None:
        """Draw the picture, hands and boxes over it, buttons and the line."""
        scale, free = ui_scale(), screen.free_box(viewport.area, viewport.region)
        with drawing.blended():
            drawing.fill_box((0.0, 0.0, viewport.region.width, viewport.region.height), (*DARK, 1.0))
            if self.picture_view is not None:
                self._draw_picture(viewport, self.matrix(viewport), scale)
            for button in self.buttons(viewport):
                self._draw_button(button, scale)
            text, warning = self.status_line()
            shade = drawing.DOUBT_COLOR if warning else drawing.WRIST_COLOR
            tag_box("", 0.0, 0.0, scale)  # sets the font's size
            for number, line in enumerate(wrapped(text, free[2] - free[0] - 12.0 * scale)):
                box = tag_box(line, free[0], free[3] - (26.0 + 20.0 * number) * scale, scale)
                draw_tag(line, box, (*DARK, 0.85), shade, scale)

    def _draw_picture(self, viewport: view.Viewport, matrix: np.ndarray, scale: float) -> None:
        assert self.picture_view is not None
        width, height = self.picture_view.size
        if self._texture is not None:
            left, bottom, right, top = (
                mapped(matrix, np.array([[0.0, height], [width, 0.0]])).ravel().tolist()
            )
            screen.draw_texture(self._texture, (left, bottom, right, top))
        places = {hand: mapped(matrix, hand.points) for hand in self.choice.hands}
        self._draw_skeletons(places, scale)
        for hand in self.choice.hands:
            if hand.chosen or hand is self.hovered:
                low, high = places[hand].min(axis=0) - 6.0 * scale, places[hand].max(axis=0) + 6.0 * scale
                shade = PIN_COLOR if hand is self.hovered else CHOSEN_COLOR
                frame_box((*low, *high), (*DARK, 0.6), 3.5 * scale)
                frame_box((*low, *high), (*shade, 1.0), 1.8 * scale)
        boxes = [
            (np.add([[0.0], [1.0]] * np.array(box[2:]), box[:2]), "Looking ...")
            for box in (*self._asked.values(), *self._boxes)
            if box
        ]
        if self.dragged is not None:
            boxes.append((self.picture_point(viewport, np.array(self.dragged)), ""))
        for ends, said in boxes:
            low, high = np.sort(mapped(matrix, ends), axis=0)
            frame_box((*low, *high), (*DARK, 0.9), 4.0 * scale)
            frame_box((*low, *high), (*PIN_COLOR, 1.0), 1.5 * scale)
            if said:
                box = tag_box(said, low[0], high[1] + 4.0 * scale, scale)
                draw_tag(said, box, (*DARK, 0.85), PIN_COLOR, scale)

    def _draw_skeletons(self, places: dict[FoundHand, np.ndarray], scale: float) -> None:
        """Draw the lines of hands, those of small ones last and thinner."""
        for small in (False, True):
            hands = [
                hand for hand, at in places.items() if (np.ptp(at, axis=0).max() < SMALL * scale) == small
            ]
            colors = []
            for hand in hands:
                color = np.pad(drawing.LINE_COLORS[:, :3], ((0, 0), (0, 1)), constant_values=1.0)
                if not hand.chosen:
                    color[:, :3] = PIN_COLOR if hand is self.hovered else LEFT_OUT_COLOR
                colors.append(color.repeat(2, axis=0))
            if hands:
                ends = np.concatenate([places[hand][drawing.LINES].reshape(-1, 2) for hand in hands])
                width, rim = (1.2, 1.2) if small else (2.2, 2.5)
                draw_shape("LINES", ends, np.tile((*DARK, 0.75), (len(ends), 1)), (width + rim) * scale)
                draw_shape("LINES", ends, np.concatenate(colors), width * scale)

    def _draw_button(self, button: Button, scale: float) -> None:
        hand = button.hand
        under = button.name == self.pressed and hand in (None, self.hovered)
        strong = button.name in ("capture", "add") if hand is None else hand.chosen
        fill = np.array(CHOSEN_COLOR if strong else DARK) + 0.15 * under
        shade = PIN_COLOR if strong or under else LEFT_OUT_COLOR
        text, size = (f"   {button.text}   ", 1.2 * scale) if hand is None else (button.text, scale)
        draw_tag(text, button.box, (*fill, 1.0), shade, size)
        if hand is None or under:
            frame_box(button.box, (*shade, 0.6), scale)


def row_of(left: Name | None, middle: Name, right: Name | None, free: Box) -> list[Button]:
    """Return buttons beside each other in the lower strip: `middle` lies in its middle whatever lies beside
    it."""
    scale = ui_scale()

    def button(name: Name, x: float) -> Button:
        return Button(*name, tag_box(f"   {name[1]}   ", x, free[1] + 2.0 * scale, 1.2 * scale))

    def width(name: Name) -> float:
        box = button(name, 0.0).box
        return box[2] - box[0]

    found = [button(middle, (free[0] + free[2] - width(middle)) / 2.0)]
    box, gap = found[0].box, 8.0 * scale
    found += [button(left, box[0] - gap - width(left))] if left is not None else []
    return found + ([button(right, box[2] + gap)] if right is not None else [])
