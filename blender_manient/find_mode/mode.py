"""What happens while hands are chosen: the worker finds them, clicks choose, boxes are searched.

Nothing of the file is touched: the picture is a texture that the worker wrote for it, and what is chosen
becomes options of a capture.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import bpy
import gpu
import numpy as np

from handfit_core.detect.detector import Region
from handfit_core.errors import HandfitError
from handfit_core.geometry.picture_map import mapped
from handfit_core.media.frame_range import FrameRange
from handfit_core.options import CaptureOptions, region_of
from handfit_core.skeleton import other_side

from .. import cache, details, jobs, screen, shared_worker
from ..keypoint_mode import view
from ..wording import capitalised, counted
from . import drawing
from .choice import Choice, FoundHand, PictureView

REACH: Final = 14.0
"""pixels from a point of a hand within which the mouse means it, at a user interface scale of 1"""
CLICK_PIXELS: Final = 6.0
"""pixels at a user interface scale of 1. A press that moves less is a click"""
MIN_BOX_PIXELS: Final = 8.0
"""pixels of the picture a side: in smaller boxes nobody sees a hand"""

_KEYS = (
    "Click: Choose Hand    Click L or R: Other Side    Drag: Look in a Box    X: Throw Out    "
    "A: All or None    Wheel: Zoom    Middle Mouse: Move    Home: Whole Picture    Ctrl Z: Undo    "
    "Enter: Capture    Esc: Leave"
)
NOTHING_THERE: Final = (
    "No hand was found in the box: draw it closer around the hand, or over all of it, or lay a hand there "
    "yourself with Add Hand"
)


class Source(NamedTuple):
    """The files, the frame and the options of a search for hands."""

    files: tuple[str, ...]
    frame: int | None
    """of the source; None for a photo"""
    options: CaptureOptions

    def fields(self, box: tuple[float, ...] | None = None, picture: Path | None = None) -> dict[str, Any]:
        """A `find` request's: for all hands, for the one in a box, or for the `picture` alone."""
        options = replace(
            self.options,
            frames=None if self.frame is None else FrameRange(self.frame, self.frame),
            regions=() if box is None else (region_of(box),),
            only_regions=box is not None or picture is not None,
        )
        fields = {"input": list(self.files), "options": options.to_message()}
        return fields if picture is None else {**fields, "picture": str(picture)}


class _BoxSearch(NamedTuple):
    """A request that searches a box for a hand."""

    request: int
    box: tuple[float, ...]


class FindMode:
    """The state of the mode, from its start to `end`."""

    keys: Final = _KEYS

    def __init__(self, source: Source, viewport: view.Viewport, source_path: str) -> None:
        """Ask the worker. `source_path`: what the panel names as the source now. Raises HandfitError."""
        self.source = source
        self.source_path = source_path
        self.choice = Choice()
        self.picture_view: PictureView | None = None
        self.message = ""
        self.hovered: FoundHand | None = None
        self.pressed = ""
        """Name of the button under the mouse"""
        self.dragged: tuple[np.ndarray, np.ndarray] | None = None
        """(2,) pixels of the region each: where the mouse was pressed, and where it is"""
        self.nothing_there = False
        """Whether the last box had no hand in it"""
        self.ended = False
        self.address = viewport.area.as_pointer()
        self._texture: gpu.types.GPUTexture | None = None
        self._searches: list[_BoxSearch] = []
        self._picture = cache.temporary_take("picture").with_suffix(".jpg")
        self._showing = shared_worker.worker().submit("find", **source.fields(picture=self._picture))
        self._finding = shared_worker.worker().submit("find", **source.fields())
        self._handler = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")
        viewport.area.tag_redraw()

    def end(self) -> None:
        """Leave nothing behind. May be called twice."""
        if self._handler is None:
            return
        bpy.types.SpaceView3D.draw_handler_remove(self._handler, "WINDOW")
        self._handler, self._texture, self.ended = None, None, True
        self._cancel_requests()
        self._picture.unlink(missing_ok=True)
        screen.redraw("VIEW_3D")

    def trouble(self, context: bpy.types.Context) -> str | None:
        """Why the mode cannot go on, in a sentence; empty where there is nothing to say."""
        if self.ended:
            return ""
        if jobs.busy():
            return "Find Hands: a capture has begun"
        if view.viewport_at(context, self.address) is None:
            return "Find Hands: the viewport is gone"
        if context.scene is None or context.scene.manient.source != self.source_path:
            return "Find Hands: another source was chosen"
        return None

    # The worker

    @property
    def busy(self) -> bool:
        """Whether the worker still searches."""
        return bool(self._showing or self._finding or self._searches)

    def tick(self, context: bpy.types.Context) -> None:
        """Look for answers."""
        try:
            if self._showing and (found := shared_worker.answer(self._showing)) is not None:
                self._showing = 0
                self.picture_view = PictureView((found["width"], found["height"]))
                self._texture = screen.texture_of(str(self._picture))
                screen.redraw("VIEW_3D")
            if self._finding and (found := shared_worker.answer(self._finding)) is not None:
                self._finding = 0
                self.choice.show(found["hands"], context.scene.manient.hands)
                screen.redraw("VIEW_3D")
            for search in list(self._searches):
                if (found := shared_worker.answer(search.request)) is not None:
                    self._searches.remove(search)
                    self.message = ""
                    self._add_found(search.box, found["hands"])
                    screen.redraw("VIEW_3D")
        except (HandfitError, RuntimeError) as error:
            self._cancel_requests()
            self.message = capitalised(str(error).strip())
            details.write_details("Find Hands", self.message, getattr(error, "details", "") or "")
            screen.redraw("VIEW_3D")

    def _cancel_requests(self) -> None:
        for request in (self._showing, self._finding, *(search.request for search in self._searches)):
            if request:
                shared_worker.worker().cancel(request)
                shared_worker.abandon(request)
        self._showing, self._finding, self._searches = 0, 0, []

    def search_box(self, corners: np.ndarray) -> None:
        """Have the worker detect a hand in a box with these corners (2, 2), pixels of the picture."""
        assert self.picture_view is not None
        low, high = np.clip(np.sort(corners, axis=0), 0.0, self.picture_view.size)
        if (high - low).min() < MIN_BOX_PIXELS:
            return
        box = (*low.tolist(), *(high - low).tolist())
        self.message, self.nothing_there = "", False
        request = shared_worker.worker().submit("find", **self.source.fields(box))
        self._searches.append(_BoxSearch(request, box))

    def _add_found(self, box: tuple[float, ...], hands: list[dict[str, Any]]) -> None:
        self.nothing_there = not hands
        for hand in hands:
            self.choice.add(FoundHand.of(hand, drawn=box))

    def regions(self) -> tuple[Region, ...]:
        """The chosen hands as a capture's regions."""
        return self.choice.regions(self.source.frame)

    # The mouse

    def room(self, viewport: view.Viewport) -> drawing.Box:
        """Where the whole picture fits in, pixels of the region."""
        return drawing.picture_room(screen.free_box(viewport.area, viewport.region))

    def picture_point(self, viewport: view.Viewport, mouse: np.ndarray) -> np.ndarray:
        """A place (2,) in pixels of the region -> in pixels of the picture."""
        assert self.picture_view is not None
        return mapped(np.linalg.inv(self.picture_view.matrix(self.room(viewport))), mouse)

    def hover(self, viewport: view.Viewport, mouse: np.ndarray) -> bool:
        """Take the mouse's place, (2,) pixels of the region; whether that changes what is shown."""
        before = self.hovered, self.pressed
        button = next((b for b in reversed(self.buttons(viewport)) if b.holds(*mouse)), None)
        self.pressed = button.name if button is not None else ""
        self.hovered = button.hand if button is not None else None
        if button is None and self.picture_view is not None:
            scale = self.picture_view.scale(self.room(viewport))
            self.hovered = self.choice.hand_at(
                self.picture_point(viewport, mouse), scale, REACH * screen.ui_scale()
            )
        return before != (self.hovered, self.pressed)

    def click(self) -> str:
        """Handle a click on what the mouse is over; the name of the button that the operator has to
        handle."""
        if self.pressed and self.pressed != "side":
            return self.pressed
        if self.hovered is not None:
            self.message, self.nothing_there = "", False
            (self.choice.flip_side if self.pressed == "side" else self.choice.toggle)(self.hovered)
        return ""

    def release(self, viewport: view.Viewport) -> str:
        """End a drag or a click; the name of the button that the operator has to handle."""
        assert self.dragged is not None
        (start, stop), self.dragged = self.dragged, None
        if np.abs(stop - start).max() < CLICK_PIXELS * screen.ui_scale():
            return self.click()
        if self.picture_view is not None:
            self.search_box(self.picture_point(viewport, np.array([start, stop])))
        return ""

    # Drawing

    def buttons(self, viewport: view.Viewport) -> list[drawing.Button]:
        """All that can be clicked on."""
        free = screen.free_box(viewport.area, viewport.region)
        tags: list[drawing.Button] = []
        if self.picture_view is not None:
            tags = drawing.side_tags(
                self.choice.hands, self.picture_view.matrix(drawing.picture_room(free)), free
            )
        count = len(self.choice.chosen)
        capture = ("capture", f"Capture {counted(count, 'Hand')}") if count else None
        add = ("add", "Add Hand") if self.nothing_there else None
        return tags + drawing.row_of(capture, ("leave", "Leave"), add, free)

    def status_line(self) -> tuple[str, bool]:
        """The line over the picture, and whether it is a warning."""
        if self.message:
            return self.message, True
        if self.hovered is not None:
            side, other = self.hovered.side.capitalize(), other_side(self.hovered.side)
            if self.pressed == "side":
                return f"{side} hand. Click: make it a {other} hand", False
            click = "leave it out" if self.hovered.chosen else "choose it"
            return f"{side} hand, {self.hovered.certainty:.0%} sure. Click: {click}. X: throw it out", False
        if self._finding:
            return "Looking for hands ...", False
        if self.nothing_there:
            return NOTHING_THERE, True
        if not self.choice.hands:
            return "No hand was found: drag a box around one that you see", True
        where = "" if self.source.frame is None else f"Frame {self.source.frame}: "
        found, chosen = counted(len(self.choice.hands), "hand"), len(self.choice.chosen)
        return f"{where}{found} found, {chosen} chosen. Drag a box around a hand that is missing", False

    def _draw(self) -> None:
        context = bpy.context
        if context.area is None or context.area.as_pointer() != self.address or self.ended:
            return
        viewport = view.viewport_at(context, self.address)
        if viewport is None or context.region != viewport.region:
            return
        boxes = [
            (np.array([search.box[:2], np.add(search.box[:2], search.box[2:])]), "Looking ...")
            for search in self._searches
        ]
        if self.dragged is not None and self.picture_view is not None:
            boxes.append((self.picture_point(viewport, np.array(self.dragged)), ""))
        text, warning = self.status_line()
        scene = drawing.Scene(
            texture=self._texture,
            picture_view=self.picture_view,
            free=screen.free_box(viewport.area, viewport.region),
            hands=self.choice.hands,
            hovered=self.hovered,
            buttons=self.buttons(viewport),
            pressed=self.pressed,
            boxes=boxes,
            text=text,
            warning=warning,
        )
        drawing.draw(scene, (viewport.region.width, viewport.region.height))


current: FindMode | None = None
"""The mode that runs"""
