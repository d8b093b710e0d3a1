"""A take's contact sheet: some of its frames side by side, with the captured hands drawn over the footage.

It needs OpenCV and no graphics card: whoever looks through a thousand captures sees which of them fit.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.errors import HandfitError
from handfit_core.common.files import is_file, written_whole
from handfit_core.common.skeleton import KEYPOINT_PARENTS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.files import kept_model
from handfit_core.media.pictures import read_picture
from handfit_core.media.source import Wanted
from handfit_core.media.videos import Video
from handfit_core.take import HandTrack, Take
from handfit_core.take.fit_quality import IN_PICTURE, Scale, error_is_known, expected_scale, relative_errors

SUFFIX: Final = ".sheet.jpg"
"""Ending of a contact sheet's file name"""


@dataclass(frozen=True)
class SheetSettings:
    """How a contact sheet is laid out, and how hands are drawn on it."""

    widest: float = 2.0
    """Greatest width of a frame on the sheet, in heights; what is wider is shown smaller"""
    around: float = 1.6
    """Size of a close-up, in sizes of the hands that it shows"""
    close: float = 0.6
    """Share of the picture's size below which a view of the hands counts as a close-up"""
    closest: float = 0.05
    """Least size of a close-up, as a share of the picture's size"""
    gap: int = 4
    """Pixels between frames"""
    ground: int = 46
    """Brightness, 0..255, of the ground where the footage is gone"""
    finer: int = 2
    """Samples of a pixel along either axis with which the hands are drawn"""
    subpixel: int = 4
    """Bits by which a triangle's corners are placed within a sample"""
    opacity: float = 0.75
    """Share, 0..1, of the footage that a hand covers; the rest lets its outline be compared"""
    nearest: float = 0.01
    """Metres from the camera; what reaches closer has no outline in its picture"""
    farthest: int = 1 << 14
    """Distance from the sheet's corner, in samples, beyond which it does not matter where a corner of a hand
    lies"""


SHEET: Final = SheetSettings()


_DARK, _LIGHT = np.array([10.0, 40.0, 70.0]), np.array([130.0, 215.0, 255.0])
"""RGB colours, 0..255, of the hands from shadow to full light: nothing in a picture of a hand has this
blue"""


def write_sheet(
    take: Take,
    path: str | os.PathLike[str],
    *,
    frames: int = 4,
    height: int = 240,
    max_megapixels: float | None = None,
) -> list[int]:
    """Write the contact sheet of a take as JPEG; returns the source numbers of the frames on it.

    `frames` frames at most, each `height` pixels high: spread over those with a hand, the most doubtful one
    among them; where one is not good, or nobody knows, with its likely error. Small hands are shown close up,
    behind the whole first picture, and those of a photo each by itself. Where the footage is not there any
    more, hands are drawn on plain ground. `max_megapixels` is what it may have, as in `open_media`. Raises
    OutputError.
    """
    import cv2

    rows = _chosen(take, frames)
    whole, hands = _View(0, 0, take.width, take.height), list(take.hands)
    if len(rows) == 1:  # of one picture the most doubtful hands each by itself, of a clip all, which move
        hands.sort(key=lambda hand: -np.nan_to_num(_errors(take, [hand])[1][rows[0]]))
    groups = [hands] if len(rows) > 1 else [[hand] for hand in hands[:frames]]
    close = [(view, group) for group in groups if (view := whole.around(take, rows, group)) != whole]
    views = [(whole, hands), *close]
    cells = []
    for row, picture in zip(rows, _footage(take, rows, max_megapixels), strict=True):
        for view, group in views if row == rows[0] else views[-1:]:
            cell = view.cell(take, row, picture, height)
            scale, errors = _errors(take, group)
            good = not np.isfinite(errors[row]) or scale.quality(errors[row]) == "good"
            said = "" if good else f"  {scale.said(errors[row])}"
            if not any(map(error_is_known, group)):
                said = "  not known"
            _write(cell, f"{take.frame_numbers[row]}{said}", doubtful=not good)
            cells += [cell, np.full((height, SHEET.gap, 3), 255, dtype=np.uint8)]
    sheet = np.concatenate(cells[:-1], axis=1)
    encoded = cv2.imencode(".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 82])[1]
    with written_whole(path) as beside:
        beside.write_bytes(encoded.tobytes())
    return take.frame_numbers[rows].tolist()


@dataclass(frozen=True)
class _View:
    """A part of the take's picture, in pixels."""

    left: int
    top: int
    width: int
    height: int

    def around(self, take: Take, rows: Sequence[int], hands: Sequence[HandTrack]) -> _View:
        """Cut out the part of this view, in its proportions, that shows these hands in all these rows; return
        the whole view where that would hardly be closer."""
        joints = [hand.joints_3d[row] for hand in hands for row in rows if hand.present[row]]
        points = np.concatenate([take.intrinsics.project(each) for each in joints] or [np.zeros((1, 2))])
        if not joints or not np.isfinite(points).all():
            return self
        size = np.array([self.width, self.height])
        low, high = np.clip([points.min(axis=0), points.max(axis=0)], 0, size)
        part = SHEET.around * max((high - low) / size)
        if not 0.0 < part < SHEET.close:
            return self
        wide, tall = np.maximum(np.ceil(max(part, SHEET.closest) * size), 1).astype(int)
        left, top = np.clip((low + high - [wide, tall]) / 2.0, 0, size - [wide, tall]).astype(int)
        return _View(int(left), int(top), int(wide), int(tall))

    def cell(self, take: Take, row: int, picture: np.ndarray | None, height: int) -> np.ndarray:
        """Draw the hands of a row over this part of its picture (H, W, 3), or over plain ground where there
        is none; return (height, W', 3) RGB."""
        import cv2

        scale = min(height / self.height, SHEET.widest * height / self.width)
        size = max(1, round(scale * self.width)), max(1, round(scale * self.height))
        cell = np.full((height, size[0], 3), SHEET.ground, dtype=np.uint8)
        shown = cell[(height - size[1]) // 2 :][: size[1]]
        if picture is not None:
            part = picture[self.top :, self.left :][: self.height, : self.width]
            cv2.resize(part, size, shown, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        lens = take.intrinsics
        values = lens.fx, lens.fy, lens.cx - self.left, lens.cy - self.top
        _draw_hands(shown, take, row, Intrinsics(*(SHEET.finer * scale * value for value in values)))
        return cell


def _chosen(take: Take, count: int) -> list[int]:
    """Return the rows of the take's T frames that are shown on the sheet, at most `count`."""
    scale, errors = _errors(take, take.hands)
    present = np.any([np.zeros(len(errors), dtype=bool), *(hand.present for hand in take.hands)], axis=0)
    rows = np.flatnonzero(present if present.any() else ~present)
    chosen = rows[np.linspace(0, len(rows) - 1, count).round().astype(int)]
    worst = rows[np.where(np.isfinite(errors), errors, -1.0)[rows].argmax()]
    if scale.quality(float(errors[worst])) != "good":
        chosen[np.abs(chosen - worst).argmin()] = worst
    return np.unique(chosen).tolist()


def _errors(take: Take, hands: Sequence[HandTrack]) -> tuple[Scale, np.ndarray]:
    """Return the scale of errors, and (T,) how far off the worst of these hands is likely to be in each
    frame, in its unit; NaN where that is not told."""
    unknown = np.full(len(take.frame_numbers), np.nan)
    likely = [hand.expected_error.mean(axis=1) for hand in hands if hand.expected_error is not None]
    shares = [relative_errors(hand, take.intrinsics) for hand in hands]
    seen = max((int(hand.detected.sum()) for hand in hands), default=0)
    return expected_scale(seen) if likely else IN_PICTURE, np.fmax.reduce([unknown, *(likely or shares)])


def _footage(take: Take, rows: Sequence[int], max_megapixels: float | None) -> Iterator[np.ndarray | None]:
    """Yield the picture (H, W, 3) of each of these rows; None where it is gone, unreadable, or not the
    take's."""
    source, numbers = take.source, take.frame_numbers
    found: Iterator[np.ndarray | None] = iter(())
    with contextlib.suppress(HandfitError):
        if source.kind != "video":
            found = (_picture(source.files[row : row + 1], max_megapixels) for row in rows)
        elif is_file(source.files[0]):
            video = Video(Path(source.files[0]), Wanted(max_megapixels=max_megapixels))
            found = video.pictures(numbers[rows].tolist())
    for _ in rows:
        picture = next(found, None)
        fits = picture is not None and picture.shape[:2] == (take.height, take.width)
        yield picture if fits else None


def _picture(file: Sequence[str], max_megapixels: float | None) -> np.ndarray | None:
    """Return the picture (H, W, 3) of a file; None where there is none that can be read."""
    with contextlib.suppress(HandfitError):
        if file and is_file(file[0]):
            return read_picture(Path(file[0]), max_megapixels=max_megapixels)[0]
    return None


def _draw_hands(picture: np.ndarray, take: Take, row: int, camera: Intrinsics) -> None:
    """Draw the hands of a row over a picture (H, W, 3); the pixels of `camera` are the samples of a finer
    one."""
    import cv2

    finer = np.zeros((SHEET.finer * picture.shape[0], SHEET.finer * picture.shape[1], 4), dtype=np.uint8)
    hands = [
        hand for hand in take.hands if hand.present[row] and hand.joints_3d[row, :, 2].min() > SHEET.nearest
    ]
    for hand in sorted(hands, key=lambda hand: -hand.joints_3d[row, :, 2].mean()):
        _draw_hand(finer, hand, row, take.model, camera)
    drawn = cv2.resize(finer, picture.shape[1::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    # Where a pixel is half covered, its colour is half as well: premultiplied.
    picture[:] = picture * (1.0 - SHEET.opacity / 255.0 * drawn[..., 3:]) + SHEET.opacity * drawn[..., :3]


def _draw_hand(finer: np.ndarray, hand: HandTrack, row: int, model: str, camera: Intrinsics) -> None:
    """Draw the mesh of a hand into an RGBA picture, the farthest triangles first; its skeleton where the
    model is gone or the mesh reaches behind the camera."""
    import cv2

    corners = np.empty((0, 3, 3))
    with contextlib.suppress(HandfitError):
        found = kept_model(model, hand.side)
        posed = found.posed(hand.betas, hand.global_orient[row], hand.hand_pose[row], hand.transl[row])
        corners = posed.vertices[found.faces]
    if not (corners[..., 2] > SHEET.nearest).all() or not len(corners):
        ends = _samples(camera.project(hand.joints_3d[row]))
        for end, parent in enumerate(KEYPOINT_PARENTS):
            if parent >= 0:
                cv2.line(
                    finer, ends[parent], ends[end], (*_LIGHT, 255), 3 * SHEET.finer, shift=SHEET.subpixel
                )
        return
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    order = np.argsort(-corners[..., 2].mean(axis=1))  # also of those seen from within, at the wrist's end
    # Unit vector to the light in the camera frame: from the left above, behind the camera
    light = np.maximum(normals[order] @ np.array([-0.45, -0.65, -0.62]), 0.0)[:, None]
    colors = np.column_stack([_DARK + light * (_LIGHT - _DARK), np.full(len(order), 255.0)]).tolist()
    for triangle, color in zip(_samples(camera.project(corners[order])), colors, strict=True):
        cv2.fillConvexPoly(finer, triangle, color, shift=SHEET.subpixel)


def _samples(pixels: np.ndarray) -> np.ndarray:
    """Places (..., 2) where (0, 0) is a picture's corner, as OpenCV takes them: in parts of a sample, from
    the middle of the first."""
    near = np.clip(np.nan_to_num(pixels), -SHEET.farthest, SHEET.farthest)
    return ((near - 0.5) * (1 << SHEET.subpixel)).round().astype(np.int32)


def _write(cell: np.ndarray, text: str, *, doubtful: bool) -> None:
    """Write a line into the lower left corner of a cell, dark around, so that it can be read on anything."""
    import cv2

    at, font = (6, len(cell) - 8), cv2.FONT_HERSHEY_SIMPLEX
    for color, thickness in ((0, 0, 0), 3), ((255, 190, 60) if doubtful else (255, 255, 255), 1):
        cv2.putText(cell, text, at, font, 0.5, color, thickness, cv2.LINE_AA)
