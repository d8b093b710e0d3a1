"""The files behind a path that the panel names, and what it shows of them: kind, size and frames.

Looked up when the path changes, not when the panel is drawn. Size, frames and pictures of single frames come
from the worker, which is started by that and is warm when the artist presses the button.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import bpy
import bpy.utils.previews
import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.retiming import shown_numbers
from handfit_core.common.errors import HandfitError, InputError, OptionError
from handfit_core.common.files import shown, why
from handfit_core.interchange.opening import is_recording
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.headers import is_animated
from handfit_core.media.kinds import what_is
from handfit_core.media.opening import (
    PHOTO_SUFFIXES,
    VIDEO_SUFFIXES,
    numbered_like,
    pictures_and_others,
    sequence_numbers,
    to_read,
)
from handfit_core.media.size_limit import check_for_blender, is_picture, is_video
from handfit_core.media.source import SourceKind
from handfit_core.take import is_take

from ..common import preferences, screen
from ..common.wording import capitalised, without_name
from ..scene.camera_clip import CameraClip, camera_clips
from ..scene.matching import Footage
from ..scene.store import captures_of, clip_timing
from . import cache, jobs, shared_worker

_KINDS = {
    "photo": "Photo",
    "sequence": "Image sequence",
    "video": "Video",
    "data": "Hands of another program",
}
_POLL_SECONDS = 0.1
"""Seconds between two looks for the worker's answers"""


@dataclass(frozen=True)
class SourceFiles:
    """The files that a capture reads."""

    kind: SourceKind
    """The kind of the source; `data` is another program's hands"""
    files: tuple[str, ...]
    """Absolute paths: of the photo, the video, the other program's file or folder, or every picture of a
    sequence in order"""
    left_out: str = ""
    """A sentence about other files of the folder, which are not read; empty where there are none"""

    @property
    def numbers(self) -> list[int] | None:
        """Return the frame numbers of a numbered sequence; None for anything else."""
        return sequence_numbers([Path(f) for f in self.files]) if self.kind == "sequence" else None


def resolve(path_text: str, *, as_sequence: bool) -> SourceFiles:
    """Return the files behind a path of the panel. Blender's `//` and `~` are understood.

    Raises InputError with a sentence for the panel.
    """
    try:
        return _resolved(path_text, as_sequence)
    except (OSError, RuntimeError, ValueError) as error:  # names that no file can have, ~nobody
        why_not = why(error) if isinstance(error, (OSError, ValueError)) else str(error)
        raise InputError(f"{shown(path_text)} cannot be opened ({why_not}): choose another file") from error


def _resolved(path_text: str, as_sequence: bool) -> SourceFiles:
    if not path_text:
        raise InputError("Choose a photo or a clip")
    # Absolute, since Blender and FFmpeg take a relative name that begins with "http:" for an address.
    path = Path(bpy.path.abspath(path_text)).expanduser().absolute()
    if is_recording(path) and not is_take(path):
        return SourceFiles("data", (str(path),))
    if path.is_dir():
        pictures, _, left_out = to_read(Path(path.name), *pictures_and_others(path))
        if not pictures:
            raise InputError(f"No pictures in the folder {path.name}: choose a file or another folder")
        kind = "sequence" if len(pictures) > 1 else "photo"
        return SourceFiles(kind, tuple(map(str, pictures)), left_out)
    if not path.is_file():
        raise InputError(f"{path.name} is not there any more: choose the file again")
    suffix = path.suffix.lower()
    picture = suffix in PHOTO_SUFFIXES or is_picture(path)
    if suffix in VIDEO_SUFFIXES or (is_animated(path) if picture else is_video(path)):
        return SourceFiles("video", (str(path),))
    if picture:
        numbered = numbered_siblings(path) if as_sequence else []
        if len(numbered) > 1:
            return SourceFiles("sequence", tuple(map(str, numbered)))
        return SourceFiles("photo", (str(path),))
    if is_take(path):
        raise InputError(f"{path.name} is a take: open it with File > Import > Hand Take")
    raise InputError(f"{path.name}: {what_is(path)}")


def numbered_siblings(path: Path) -> list[Path]:
    """Return the pictures beside `path` whose names differ from its own in the last number only, in order;
    without the numbers of a camera's counter (see `sequence_numbers`)."""
    beside = [file for _, file in numbered_like(path)]
    return beside if len(beside) > 1 and sequence_numbers(beside) is not None else []


@dataclass
class SourceInfo:
    """One source, as far as it is known."""

    path: str
    as_sequence: bool
    files: SourceFiles | None = None
    problem: str = ""
    siblings: int = 0
    """How many numbered pictures lie beside a photo, with it"""
    frames: int = 0
    """How many frames the source has; 0 while unknown"""
    width: int = 0
    height: int = 0
    fps: float = 0.0
    first: int = 1
    last: int = 1
    unsized: bool = False
    """True if these are another program's hands in pictures of a size that their file does not tell"""
    pictured: int | None = None
    picture: str = ""
    """The path of the file with the newest picture of a frame that came; empty before"""

    def has_frame(self, number: int) -> bool:
        """True if the source may have a frame of that number, as far as is known."""
        if not self.frames or self.files is None:
            return number >= 0
        return number in (self.files.numbers or range(self.first, self.last + 1))

    @property
    def is_gone(self) -> bool:
        """True if the source's file was there and is not any more."""
        return self.files is not None and not Path(self.files.files[0]).exists()


Field = Literal["source", "second_view"]
"""The panel's settings that name what is captured"""
VIEWS: tuple[Field, ...] = ("source", "second_view")

_known: dict[Field, SourceInfo] = {}
_asked: list[tuple[shared_worker.Asking, SourceInfo, Callable[[SourceInfo, dict[str, Any]], None]]] = []
"""Requests to the worker, the sources that they are about, and what takes up their answers"""
_previews: Any = None


def of(settings, field: Field = "source") -> SourceInfo:
    """Return what is known of the panel's source, or of its second view; cheap enough for drawing."""
    if not _is_known(settings, field) or _known[field].is_gone:
        _known[field] = _inspect(*_wanted(settings, field))
    return _known[field]


def _wanted(settings, field: Field) -> tuple[str, bool]:
    return getattr(settings, field), settings.as_sequence and field == "source"


def _is_known(settings, field: Field) -> bool:
    return field in _known and (_known[field].path, _known[field].as_sequence) == _wanted(settings, field)


def has_views(info: SourceInfo) -> bool:
    """True if a source is one of which a second camera may have filmed another view."""
    return info.files is not None and info.files.kind in ("video", "sequence")


def footage(settings, info: SourceInfo, *, only: int | None = None) -> Footage | None:
    """Return what a scene would be matched to by capturing the panel's source, or `only` one frame of it;
    None while nobody knows."""
    width, height = settings.picture_size if info.unsized else (info.width, info.height)
    clip = camera_clip(settings, info.files)
    if info.files is None or not (clip or (width and height)):
        return None
    first, last = info.first, info.last
    if info.files.kind != "photo" and settings.use_frames:
        first, last = settings.first_frame, settings.last_frame
    if only is not None:
        first = last = only
    if settings.camera == "ACTIVE":
        width = height = 0
    timed, placed = info.files.kind in ("video", "data"), clip.timing if clip else None
    return Footage(info.fps, first, last, width, height, timed, placed)


def camera_clip(settings, files: SourceFiles | None) -> CameraClip | None:
    """Return the clip of the scene's camera, if it is what the panel's source names and that camera is used;
    else None."""
    if files is None or settings.camera != "ACTIVE" or files.kind not in ("video", "sequence"):
        return None
    return next((clip for clip in camera_clips(settings.id_data) if clip.is_of(files.files)), None)


def shown_frame(context: bpy.types.Context, files: SourceFiles) -> int:
    """Return the source's frame at the scene's current frame: that which a capture of it shows there, else
    the one of that number."""
    frame = context.scene.frame_current
    clip = camera_clip(context.scene.manient, files)
    if clip is not None:
        return int(clip.timing.source_frames(np.array([frame]))[0])
    with contextlib.suppress(HandfitError):  # a take that cannot be read
        for capture in captures_of(context, files.kind, files.files):
            (frame,) = shown_numbers(clip_timing(capture).source_frames(np.array([frame]))).tolist()
            break
    return frame


def lacks_size(settings, info: SourceInfo) -> bool:
    """True if the artist has yet to say how large the source's pictures are."""
    return info.unsized and not all(settings.picture_size)


def dropped_footage(settings, path: Path) -> Footage | None:
    """Return what a scene would take over from a dropped file; None but for videos, whose headers Blender
    reads at once."""
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        return None
    try:
        check_for_blender(path, preferences.get().max_megapixels or None)
        clip = bpy.data.movieclips.load(str(path.absolute()))
    except (InputError, RuntimeError):
        return None
    try:
        width, height = (0, 0) if settings.camera == "ACTIVE" else clip.size
        own = [one.timing for one in camera_clips(bpy.context.scene) if one.is_of((str(path),))]
        footage = Footage(clip.fps, 1, clip.frame_duration, width, height, placed=next(iter(own), None))
        return footage if clip.size[0] else None
    finally:
        bpy.data.movieclips.remove(clip)


def source_changed(settings, field: Field = "source") -> None:
    """Forget the former source or second view, and ask the worker about the new one."""
    _known.pop(field, None)
    info = of(settings, field)
    if info.files is None or bpy.app.background:
        return
    _ask(info, _describe, "probe", max_megapixels=preferences.get().max_megapixels or None)


def _ask(
    info: SourceInfo, then: Callable[[SourceInfo, dict[str, Any]], None], kind: str, **fields: Any
) -> None:
    """Send the worker a request about a source."""
    assert info.files is not None
    with contextlib.suppress(HandfitError):  # the capture itself will say what is wrong with the worker
        asking = shared_worker.ask(kind, "", input=list(info.files.files), **fields)
        next(asking)
        _asked.append((asking, info, then))
        if not bpy.app.timers.is_registered(_await_answers):
            bpy.app.timers.register(_await_answers, first_interval=_POLL_SECONDS)


def source_chosen(settings) -> None:
    """Forget the former source's keypoints, size and second view, which do not belong to another one, and use
    the scene's camera if the new source is that camera's clip; undo brings all back by itself."""
    former = _known.get("source")
    source_changed(settings)
    if former is None or former.path != settings.source:
        for name in ("keypoints", "picture_size", "second_view"):
            settings.property_unset(name)
        if _is_of_camera(settings, of(settings)):
            settings.camera = "ACTIVE"
        elif former is not None and settings.camera == "ACTIVE" and _is_of_camera(settings, former):
            settings.property_unset("camera")


def _is_of_camera(settings, info: SourceInfo) -> bool:
    files = info.files
    return files is not None and any(clip.is_of(files.files) for clip in camera_clips(settings.id_data))


def view_chosen(settings) -> None:
    """Forget the former second view's offset and distance, which do not belong to another one."""
    if "second_view" not in _known or _known["second_view"].path != settings.second_view:
        for name in ("cameras", "view_lens", "use_offset", "use_pair", "use_baseline"):
            settings.property_unset(name)
        settings.pair = [of(settings, field).first for field in VIEWS]
    source_changed(settings, "second_view")


def pair_changed(settings) -> None:
    """Keep the two frames that show the same moment within their clips, as far as these are known."""
    infos = [of(settings, field) for field in VIEWS]
    inside = [
        min(max(frame, info.first), info.last) if info.frames else frame
        for frame, info in zip(settings.pair, infos, strict=True)
    ]
    if inside != list(settings.pair):
        settings.pair = inside


def chosen_offset(settings) -> float | None:
    """Return the seconds from the start of what is captured of the source to that of the second view, as told
    by the artist; None where it is to be found. Raises OptionError."""
    if not settings.use_offset:
        return None
    if not settings.use_pair:
        return settings.offset
    infos = [of(settings, field) for field in VIEWS]
    if not all(info.fps for info in infos):
        raise OptionError("the clips' rates are not known yet: wait until the panel shows them")
    starts = [settings.first_frame if settings.use_frames else infos[0].first, infos[1].first]
    first, second = (
        (frame - start) / info.fps for frame, start, info in zip(settings.pair, starts, infos, strict=True)
    )
    return first - second


def in_words(settings, info: SourceInfo, name: str = "") -> str:
    """Return kind, or the name, size, frames and rate of a source whose files were found, as words for one
    line."""
    assert info.files is not None
    clip = None if name else camera_clip(settings, info.files)
    kind = _KINDS[info.files.kind]
    if clip is not None:
        kind = "Tracked clip" if clip.is_solved else "Camera's clip"
    said = [name or kind]
    if info.files.kind != "data" and info.width:
        said.append(f"{info.width}×{info.height}")
    if info.files.kind != "photo" and info.frames:
        said.append(f"{info.first}-{info.last}")
        if info.fps and info.files.kind in ("video", "data"):
            said.append(f"{info.fps:.5g} fps")
    return ", ".join(said) + (f". {info.files.left_out}" if info.files.left_out else "")


def frame_picture(info: SourceInfo, frame: int) -> int:
    """Return the icon of one frame, which the worker is asked for; until it comes, that of the last one, or
    0."""
    if info.files is None or bpy.app.background:
        return 0
    if info.pictured != frame and not any(about is info for _, about, _ in _asked):
        info.pictured = frame
        options = CaptureOptions(
            frames=FrameRange(frame, frame),
            only_regions=True,
            max_megapixels=preferences.get().max_megapixels or None,
        )
        path = cache.temporary_take("frame").with_suffix(".jpg")

        def show(about: SourceInfo, _answer: dict[str, Any]) -> None:
            about.picture = str(path)

        _ask(info, show, "find", options=options.to_message(), picture=str(path))
    return _icon(info.picture) if info.picture else 0


def _icon(path: str) -> int:
    global _previews
    if bpy.app.background:
        return 0
    if _previews is None:
        _previews = bpy.utils.previews.new()
    previews = _previews
    if path not in previews:
        if len(previews) > 50:
            previews.clear()
        with contextlib.suppress(KeyError):
            previews.load(path, path, "IMAGE")
    return previews[path].icon_id if path in previews else 0


def _inspect(path: str, as_sequence: bool) -> SourceInfo:
    info = SourceInfo(path, as_sequence)
    try:
        info.files = resolve(path, as_sequence=as_sequence)
    except HandfitError as error:
        info.problem = str(error)
        return info
    first = Path(info.files.files[0])
    if info.files.kind == "data":
        return info
    if info.files.kind == "photo" or as_sequence:
        info.siblings = len(numbered_siblings(first))
    if info.files.kind == "sequence":
        numbers = info.files.numbers or list(range(1, len(info.files.files) + 1))
        info.frames, info.first, info.last = len(numbers), min(numbers), max(numbers)
    return info


def _describe(info: SourceInfo, found: dict[str, Any]) -> None:
    info.width, info.height = int(found["width"]), int(found["height"])
    info.fps, info.frames = float(found["fps"]), int(found["frames"])
    info.first, info.last = int(found["first"]), int(found["last"])
    info.unsized = not info.width


def _await_answers() -> float | None:
    if not _asked:
        return None
    if jobs.current() is not None:
        return 1.0  # the worker answers after that
    for one in list(_asked):
        asking, info, then = one
        try:
            found = shared_worker.advance(asking)
            if found is None:
                continue
            then(info, found)
        except HandfitError as error:
            if then is _describe:
                # The panel has the path above.
                info.problem = capitalised(without_name(str(error), info.files.files if info.files else ()))
        _asked.remove(one)
        screen.redraw_sidebars()
    return _POLL_SECONDS


def _on_undo(*_args) -> None:
    """Ask anew about sources that an undo or a redo has changed, of which no update callback tells."""
    scene = bpy.context.scene
    if scene is None:
        return
    for field in list(_known):
        if not _is_known(scene.manient, field):
            source_changed(scene.manient, field)


HANDLERS = {"undo_post": _on_undo, "redo_post": _on_undo}
LISTENERS = {
    "source": source_chosen,
    "as_sequence": source_changed,
    "second_view": view_chosen,
    "pair": pair_changed,
}
TIMERS = (_await_answers,)


def unregister() -> None:
    """Free the pictures, and forget the source."""
    global _previews
    if _previews is not None:
        bpy.utils.previews.remove(_previews)
    _previews = None
    _known.clear()
    _asked.clear()
