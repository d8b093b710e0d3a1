"""What a scenario can do with the window: move the mouse, press keys, open the panel, look, wait."""

from __future__ import annotations

import os
import statistics
import subprocess
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import addon_utils
import bpy
from meter import Meter

ADDON = os.environ.get("MANIENT_ADDON", "blender_manient")
"""The repository's, or an installed one"""
TAB, EDIT_TAB = "Hand Capture", "Hand Edit"
SETTLE = 0.3
"""seconds in which Blender takes up a change of its layout"""
SHORTCUT = "F19"
"""A key that Blender leaves alone"""
HOVER = 0.06
"""seconds until the button under the mouse lights up"""
BUTTON_STEP = 16
"""pixels; a button is at least 20 high"""
STEP = 0.01
"""seconds between looks at a condition"""

Steps = Generator[float, None, Any]


def armatures() -> list[bpy.types.Object]:
    """The file's armatures."""
    return [obj for obj in bpy.data.objects if obj.type == "ARMATURE"]


class Stage:
    """The window, as the artist's eyes and hands have it. Generator methods need `yield from`."""

    def __init__(self, screenshots: Path, meter: Meter):
        self.screenshots = screenshots
        self.meter = meter

    # The window

    @property
    def window(self) -> bpy.types.Window:
        """Blender's only window."""
        return bpy.context.window_manager.windows[0]

    def area(self, kind: str = "VIEW_3D") -> bpy.types.Area:
        """The largest editor of a kind."""
        areas = [a for a in self.window.screen.areas if a.type == kind]
        assert areas, f"there is no {kind} in this window"
        return max(areas, key=lambda a: a.width * a.height)

    def region(self, kind: str = "WINDOW") -> bpy.types.Region:
        """A region of the 3D view."""
        return next(r for r in self.area().regions if r.type == kind)

    def override(self, region: str = "WINDOW"):
        """A context as it is under the mouse in a region of the 3D view; timers have none."""
        return bpy.context.temp_override(window=self.window, area=self.area(), region=self.region(region))

    def reset(self) -> Steps:
        """A new file with nothing in it but the factory's layout; the add-on enabled; mouse in the view."""
        bpy.ops.wm.read_homefile(use_factory_startup=True)
        yield 0.1
        if not addon_utils.check(ADDON)[1]:
            assert addon_utils.enable(ADDON, default_set=True), "the add-on could not be enabled"
        for obj in list(bpy.data.objects):
            bpy.data.objects.remove(obj)
        self.area().spaces[0].shading.type = "SOLID"
        yield from self.move_to(self.region())
        yield SETTLE

    def draw_smoothly(self, *, on: bool) -> None:
        """Smooth edges as Blender does by default, or not: without a graphics card that takes most of the
        time."""
        system = bpy.context.preferences.system
        system.viewport_aa, system.use_overlay_smooth_wire = "8" if on else "OFF", on

    # Waiting

    def until(self, condition: Callable[[], Any], timeout: float, what: str | Callable[[], str]) -> Steps:
        """Wait until condition() is true; returns its value, or fails saying what did not come."""
        end = time.monotonic() + timeout
        while not (value := condition()):
            if time.monotonic() > end:
                what = what if isinstance(what, str) else what()
                raise AssertionError(f"waited {timeout:g} s in vain for {what}")
            yield STEP
        return value

    # Mouse and keys

    def move_to(self, target: Any) -> Steps:
        """Mouse to the middle of a region, or to (x, y) in pixels of the window from its lower left."""
        if isinstance(target, bpy.types.Region):
            target = self._middle(target)
        x, y = round(target[0]), round(target[1])
        self.window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
        self.mouse = (x, y)
        yield 0.0

    def _middle(self, region: bpy.types.Region) -> tuple[float, float]:
        """The middle of what the toolbar and the sidebar leave free: both lie over the view."""
        left, right = region.x, region.x + region.width
        if region.type == "WINDOW":
            covers = {r.type: r for r in self.area().regions if r.width > 1}
            if "TOOLS" in covers:
                left = max(left, covers["TOOLS"].x + covers["TOOLS"].width)
            if "UI" in covers:
                right = min(right, covers["UI"].x)
        return (left + right) / 2, region.y + region.height / 2

    def key(self, kind: str, **modifiers: Any) -> Steps:
        """Press and let go a key or mouse button where the mouse is."""
        x, y = self.mouse
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type=kind, value=value, x=x, y=y, **modifiers)
            yield 0.0

    def write(self, text: str) -> Steps:
        """Type a text where one is being edited."""
        x, y = self.mouse
        for letter in text:
            self.window.event_simulate(type="A", value="PRESS", unicode=letter, x=x, y=y)
            yield 0.0
            self.window.event_simulate(type="A", value="RELEASE", x=x, y=y)
            yield 0.0

    def click(self, target: Any) -> Steps:
        """Left click."""
        yield from self.move_to(target)
        yield from self.key("LEFTMOUSE")

    def hold(self, value: str = "PRESS") -> Steps:
        """Press the left mouse button where the mouse is; with "RELEASE", let it go."""
        x, y = self.mouse
        self.window.event_simulate(type="LEFTMOUSE", value=value, x=x, y=y)
        yield 0.0

    def drag(self, path: list[tuple[float, float]], pause: float = 0.02) -> Steps:
        """Press at the path's first point, move along it, let go at its last. Pixels of the window."""
        yield from self.move_to(path[0])
        yield from self.hold()
        yield pause
        for point in path[1:]:
            yield from self.move_to(point)
            yield pause
        yield from self.hold("RELEASE")
        yield pause

    def invoke(self, operator: str, **properties: Any) -> Steps:
        """Run an operator as its button or a shortcut does: from an event, with an undo step of its own.

        `bpy.ops` from a script would push no undo step.
        """
        keymap = bpy.context.window_manager.keyconfigs.addon.keymaps.new(name="3D View", space_type="VIEW_3D")
        item = keymap.keymap_items.new(operator, SHORTCUT, "PRESS")
        for name, value in properties.items():
            setattr(item.properties, name, value)
        yield 0.05
        yield from self.leave_popups()
        yield from self.key(SHORTCUT)
        yield 0.05
        keymap.keymap_items.remove(item)

    def leave_popups(self) -> Steps:
        """Mouse to the corner of the view and back: a report's popup goes when the mouse leaves it, and takes
        all keys until then."""
        area = self.area()
        yield from self.move_to((area.x + 5, area.y + 5))
        yield 0.05
        yield from self.move_to(self.region())
        yield 0.05

    def undo(self, **modifiers: bool) -> Steps:
        """Ctrl Z in the view."""
        yield from self.leave_popups()
        yield from self.key("Z", ctrl=True, **modifiers)
        yield 0.3

    def redo(self) -> Steps:
        """Ctrl Shift Z in the view."""
        yield from self.undo(shift=True)

    # The sidebar

    def open_sidebar(self, tab: str = TAB) -> Steps:
        """Show a tab of the 3D view's sidebar."""
        self.area().spaces[0].show_region_ui = True
        yield SETTLE
        self.region("UI").active_panel_category = tab
        self.area().tag_redraw()
        yield SETTLE
        assert self.region("UI").active_panel_category == tab, f"the sidebar has no tab {tab!r}"

    def press(self, command: str, along: float = 0.6) -> Steps:
        """Click a button or field of the sidebar by `find_button`, the wheel turned until it shows."""
        yield from self.leave_popups()
        down, up = ("WHEELDOWNMOUSE", 12), ("WHEELUPMOUSE", 60)
        for wheel, notches in (("", 0), down, down, down, up, down):
            yield from self.move_to(self.region("UI"))
            for _ in range(notches):
                yield from self.key(wheel)
            yield 0.3
            place = yield from self.find_button(command, along)
            if place is not None:
                yield from self.click(place)
                yield 0.5
                return
        raise AssertionError(f"the sidebar has no {command}")

    def find_button(self, command: str, along: float = 0.6) -> Steps:
        """The place of a button of the sidebar whose tooltip's Python command begins so, or of the field of a
        property whose data path ends so; None without one.

        Found as an artist finds it: by hovering, line after line, `along` so much of the sidebar's width.
        """
        region = self.region("UI")
        x = region.x + region.width * along
        for y in range(region.y + region.height - 10, region.y, -BUTTON_STEP):
            yield from self.move_to((x, y))
            yield HOVER
            bpy.context.window_manager.clipboard = ""
            with self.override(region="UI"):
                if bpy.ops.ui.copy_python_command_button.poll():
                    bpy.ops.ui.copy_python_command_button()
                elif bpy.ops.ui.copy_data_path_button.poll():
                    bpy.ops.ui.copy_data_path_button(full_path=True)
            said = bpy.context.window_manager.clipboard
            if said.startswith(command) or said.endswith(command):
                return (x, y)
        return None

    # Files

    def choose_file(self, path: str) -> Steps:
        """Choose a file in the browser that opens in the window, and press its button."""
        browser = yield from self.until(
            lambda: next((a for a in self.window.screen.areas if a.type == "FILE_BROWSER"), None),
            5.0,
            "the file browser",
        )
        # The browser reads the folder first; what is chosen before that is forgotten.
        parameters = yield from self.until(lambda: browser.spaces.active.params, 5.0, "the browser's folder")
        directory, _, name = path.rpartition("/")
        parameters.directory = directory.encode()
        yield 0.5
        parameters.filename = name
        yield 0.2
        with bpy.context.temp_override(window=self.window, area=browser, region=browser.regions[-1]):
            bpy.ops.file.execute()

    def reopen(self, path: str) -> Steps:
        """Save the file and open it again."""
        bpy.ops.wm.save_as_mainfile(filepath=path)
        bpy.ops.wm.read_homefile(use_factory_startup=True)
        yield 0.3
        bpy.ops.wm.open_mainfile(filepath=path)
        yield 0.5

    # Looking

    def redraw(self, count: int = 10) -> Steps:
        """Milliseconds, in the median, of a turn of the main loop in which the view is drawn."""
        times = []
        for _ in range(count):
            self.area().tag_redraw()
            began = time.perf_counter()
            yield 0.0
            yield 0.0
            times.append(1000 * (time.perf_counter() - began))
        return statistics.median(times)

    def reports(self) -> Steps:
        """What Blender has reported to the artist in this session, one message per line."""
        area = self.area("OUTLINER")
        area.type = "INFO"
        yield SETTLE
        with bpy.context.temp_override(window=self.window, area=area, region=area.regions[-1]):
            bpy.ops.info.select_all(action="SELECT")
            bpy.ops.info.report_copy()
        text = bpy.context.window_manager.clipboard
        area.type = "OUTLINER"
        yield SETTLE
        return text.splitlines()

    def look_through_camera(self) -> Steps:
        """The view through the scene's camera, as the artist has it after a capture."""
        if self.area().spaces[0].region_3d.view_perspective != "CAMERA":
            with self.override():
                bpy.ops.view3d.view_camera()
        yield SETTLE

    def screenshot(self, name: str) -> Steps:
        """Draw everything afresh, and keep a picture of the screen."""
        for area in self.window.screen.areas:
            area.tag_redraw()
        yield SETTLE
        process = self._start_screenshot(name)
        yield from self.until(lambda: process.poll() is not None, 20.0, "a screenshot")
        assert process.returncode == 0, "the screenshot failed"

    def screenshot_now(self, name: str) -> None:
        """The screen as it is."""
        self._start_screenshot(name).wait(20.0)

    def _start_screenshot(self, name: str) -> subprocess.Popen:
        # Without a graphics card, Blender's own screen.screenshot is black.
        self.screenshots.mkdir(parents=True, exist_ok=True)
        return subprocess.Popen(["import", "-window", "root", str(self.screenshots / f"{name}.png")])
