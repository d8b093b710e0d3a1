"""A lens is measured from a film of a chessboard on a screen: the board's picture, its corners in the film's
sharpest frames, and the calibration (Zhang 2000) by OpenCV."""

from __future__ import annotations

import logging
import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import Cancelled, InputError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.media.lenses import MeasuredLens
from handfit_core.media.opening import MediaInput, open_media
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Media

log = logging.getLogger("handfit")

CORNERS: Final = (11, 6)
"""Inner corners of the chessboard, where four squares meet: in a row, and in a column. One number is odd, so
that no half turn shows the same board"""


@dataclass(frozen=True)
class ChessboardSettings:
    """How the board is drawn, which frames are used, and what a film must show."""

    square: int = 120
    """Side of a square of the drawn board in pixels; with the margins the board fills a screen of 1920 x
    1080"""
    looked_at: int = 120
    """Number of parts of the film, each 0.25 s of half a minute, in each of which the sharpest frame is
    looked at"""
    used: int = 30
    """Most boards that are calibrated with; the error falls with the root of their number, the time grows
    with it"""
    least: int = 8
    """Least number of boards that must differ"""
    differing: float = 0.03
    """How far a board's outer corners must have moved for it to differ: root of the sum of squares, as a
    share of the picture's longer side"""
    search_side: int = 960
    """Longer side in pixels of the picture in which the board is searched; its corners are refined in all
    pixels"""
    most_blur: float = 1.5
    """Blur of the edges beyond which a board is left out, in times of the median width: blurred boards are
    also skewed by the rolling shutter"""
    outlying: float = 2.5
    """Error beyond which a board is left out, in times of the median error"""
    supported: float = 3.0
    """How many standard deviations from zero a term of the distortion must be, to be kept"""
    centre_sigma: float = 0.01
    """Standard deviation, as a share of the longer side, beyond which the principal point is taken to be the
    picture's middle"""
    least_parts: int = 7
    """Least number of the picture's nine parts in which corners must have been seen"""
    tilted: float = 0.06
    """Logarithm of the ratio of a board's opposite sides from which the board counts as seen from aside"""
    least_tilted: int = 4
    """Least number of boards that are seen from aside; one that is parallel to the picture says nothing about
    the focal length"""
    most_focal_sigma: float = 0.01
    """Largest standard deviation of the focal length, as a share of it; hands' distances would be off by as
    much"""
    most_error: float = 1.0 / 800.0
    """Largest root mean square error over the corners, as a share of the longer side: more is no lens, but a
    film that was stabilised or moved too fast"""


CHESSBOARD: Final = ChessboardSettings()

_UNTIL: Final = 3
"""OpenCV's TERM_CRITERIA_MAX_ITER + TERM_CRITERIA_EPS"""
_HOW: Final = (
    "show the whole board with its white margin, not too bright, and hold the camera still for a moment at "
    "each place"
)


def board_png() -> bytes:
    """Return the chessboard as a PNG file of 1920 x 1080 pixels, with a white margin of a square or more."""
    square, (across, down) = CHESSBOARD.square, CORNERS
    rows = np.add.outer(np.arange(down + 1), np.arange(across + 1)) % 2 == 0
    board = np.where(np.kron(rows, np.ones((square, square), dtype=bool)), 0, 255).astype(np.uint8)
    top, left = (1080 - board.shape[0]) // 2, (1920 - board.shape[1]) // 2
    picture = np.pad(board, ((top, top), (left, left)), constant_values=255)
    lines = np.pad(picture, ((0, 0), (1, 0)))  # each row begins with the number of its filter, which is none
    header = struct.pack(">IIBBBBB", picture.shape[1], picture.shape[0], 8, 0, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def measure_lens(
    source: MediaInput,
    on_frame: Callable[[int, int], None] = lambda _done, _total: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> MeasuredLens:
    """Measure the lens of a film, or of photos, of the board on a screen.

    `on_frame` gets the counts of frames that are read and of all, 0 where unknown; `should_stop` is asked
    before each frame.

    Raises InputError, which says what to film more, where the film is not enough, and Cancelled where it was
    stopped.
    """
    media = open_media(source)
    corners, blur, looked_at = [], [], 0
    for gray in _sharpest(media, on_frame, should_stop):
        looked_at += 1
        found = _corners(gray)
        if found is not None:
            corners.append(found[0])
            blur.append(found[1])
    boards = np.array(corners).reshape(-1, CORNERS[0] * CORNERS[1], 2)
    name = media.source.name
    size = media.width, media.height
    if len(boards):
        boards = boards[np.array(blur) <= CHESSBOARD.most_blur * np.median(blur)]
        boards = boards[_diverse(_quads(boards) / max(size))]
    if len(boards) < CHESSBOARD.least:
        seen = f"in {len(boards)} places only" if len(boards) else f"in none of {looked_at} frames"
        raise InputError(f"{name}: the chessboard was found {seen}: {_HOW}")
    _check_spread(name, boards, size)
    return _calibrated(name, boards, size)


def _sharpest(
    media: Media, on_frame: Callable[[int, int], None], should_stop: Callable[[], bool]
) -> Iterator[np.ndarray]:
    """Yield the sharpest frame (H, W) of each part of the film, in gray."""
    import cv2

    total = media.expected_frames
    part = max(1, math.ceil(total / CHESSBOARD.looked_at)) if total else 8
    best, sharpest = None, -1.0
    with closing(read_ahead(media.frames())) as frames:
        for done, frame in enumerate(frames, 1):
            if should_stop():
                raise Cancelled(f"{media.source.name}: stopped before the lens was measured")
            if frame.rgb is not None:
                gray = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
                sharp = float(cv2.Laplacian(_smaller(gray, CHESSBOARD.search_side // 2), cv2.CV_32F).var())
                if sharp > sharpest:
                    best, sharpest = gray, sharp
            if done % part == 0 and best is not None:
                yield best
                best, sharpest = None, -1.0
            on_frame(done, total)
    if best is not None:
        yield best


def _smaller(gray: np.ndarray, side: int) -> np.ndarray:
    """Scale a picture down so that its longer side has at most so many pixels."""
    import cv2

    scale = side / max(gray.shape)
    return gray if scale >= 1.0 else cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _corners(gray: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Return the board's corners (66, 2) in pixels and the width of its edges in squares; None where no board
    is found."""
    import cv2

    small = _smaller(gray, CHESSBOARD.search_side)
    found, at = cv2.findChessboardCornersSB(small, CORNERS, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    scale = np.array(gray.shape[::-1]) / small.shape[::-1]
    at = ((at[:, 0] + 0.5) * scale - 0.5).astype(np.float32)
    grid = at.reshape(CORNERS[1], CORNERS[0], 2)
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1)]
    half = max(2, round(0.3 * float(min(side.min() for side in sides))))
    fine = cv2.cornerSubPix(gray, at[:, None].copy(), (half, half), (-1, -1), (_UNTIL, 50, 1e-3))
    blur = cv2.estimateChessboardSharpness(gray, CORNERS, fine)[0][0] / float(np.mean(sides[1]))
    # OpenCV's pixels have their centres at whole numbers.
    return fine[:, 0].astype(np.float64) + 0.5, blur


def _quads(boards: np.ndarray) -> np.ndarray:
    """Return the four outer corners (N, 4, 2) of boards with corners (N, 66, 2), in order around each board,
    the upper left first."""
    across, count = CORNERS[0], boards.shape[1]
    outer = boards[:, [0, across - 1, count - 1, count - across]]
    first = outer.sum(axis=-1).argmin(axis=1)
    return np.take_along_axis(outer, ((first[:, None] + np.arange(4)) % 4)[..., None], axis=1)


def _diverse(quads: np.ndarray) -> np.ndarray:
    """Return the indices of the boards (N, 4, 2) to use, each as different as can be from those before: in
    place, distance and tilt alike, as all of them move corners."""
    rows = quads.reshape(len(quads), -1)
    away = np.linalg.norm(rows - rows.mean(axis=0), axis=1)
    chosen = [int(away.argmin())]
    away = np.linalg.norm(rows - rows[chosen[0]], axis=1)
    while len(chosen) < CHESSBOARD.used and away.max() > CHESSBOARD.differing:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(rows - rows[chosen[-1]], axis=1))
    return np.array(chosen)


def _check_spread(name: str, boards: np.ndarray, size: tuple[int, int]) -> None:
    """Raise InputError for boards that leave parts of the picture, or tilts, out."""
    parts = np.zeros((3, 3), dtype=bool)
    column, row = np.clip(boards.reshape(-1, 2) * 3 // np.array(size), 0, 2).astype(int).T
    parts[row, column] = True
    if parts.sum() < CHESSBOARD.least_parts:
        edges = {"left": parts[:, 0], "right": parts[:, 2], "top": parts[0], "bottom": parts[2]}
        lacking = [edge for edge, seen in edges.items() if seen.sum() < 2]
        raise InputError(
            f"{name}: the chessboard was seen in {parts.sum()} of nine parts of the picture only: film it "
            f"also at the {' and the '.join(lacking or edges)} of the picture"
        )
    sides = np.linalg.norm(np.roll(quads := _quads(boards), -1, axis=1) - quads, axis=-1)
    tilt = np.abs(np.log(sides[:, :2] / sides[:, 2:])).max(axis=1)
    if np.count_nonzero(tilt > CHESSBOARD.tilted) < CHESSBOARD.least_tilted:
        raise InputError(
            f"{name}: the chessboard was always filmed from the front, which does not tell the focal length: "
            "film it from the left, the right, above and below as well, some 30 to 45 degrees from aside"
        )


@dataclass(frozen=True, eq=False)
class _Calibration:
    """The result of OpenCV's calibration with N boards."""

    matrix: np.ndarray
    distortion: np.ndarray
    sigma: np.ndarray
    """Standard deviations of fx, fy, cx, cy, k1, k2, ... as OpenCV orders them"""
    errors: np.ndarray
    """(N,) root mean square error of each board's corners, in pixels"""

    @property
    def error(self) -> float:
        """Root mean square error over all corners, in pixels."""
        return float(np.sqrt(np.square(self.errors).mean()))


def _calibrated(name: str, boards: np.ndarray, size: tuple[int, int]) -> MeasuredLens:
    """Return the lens that boards (N, 66, 2) tell, with as many terms as they support. Raises InputError
    where they tell too little, or something that no lens does."""
    import cv2

    longer = max(size)
    fixed = 0
    found = _solve(boards, size, fixed)
    kept = found.errors <= CHESSBOARD.outlying * np.median(found.errors)
    if not kept.all():
        boards = boards[kept]
        found = _solve(boards, size, fixed)
    if found.sigma[2:4].max() > CHESSBOARD.centre_sigma * longer:
        fixed = cv2.CALIB_FIX_PRINCIPAL_POINT
        found = _solve(boards, size, fixed)
    for term, flag in ((1, cv2.CALIB_FIX_K2), (0, cv2.CALIB_FIX_K1)):
        if abs(found.distortion[term]) >= CHESSBOARD.supported * found.sigma[4 + term]:
            break
        fixed |= flag
        found = _solve(boards, size, fixed)
    focal, sigma = float(found.matrix[0, 0]), max(float(found.sigma[:2].max()), _scatter(boards, size, found))
    if not found.error <= CHESSBOARD.most_error * longer:
        raise InputError(
            f"{name}: the chessboard's corners lie {found.error:.1f} px from where a lens would show them: "
            f"turn the camera's stabilisation off, and {_HOW}"
        )
    if not sigma <= CHESSBOARD.most_focal_sigma * focal:
        raise InputError(
            f"{name}: the focal length is known to {100.0 * sigma / focal:.1f} % only: film the chessboard "
            "longer, from more sides, and once so near that it fills the picture"
        )
    k1, k2 = (float(term) for term in found.distortion[:2])
    intrinsics = Intrinsics(focal, focal, float(found.matrix[0, 2]), float(found.matrix[1, 2]))
    return MeasuredLens(Lens(intrinsics, (k1, k2, 0.0, 0.0, 0.0), *size), found.error, sigma, len(boards))


def _scatter(boards: np.ndarray, size: tuple[int, int], found: _Calibration) -> float:
    """Return the standard deviation, in pixels, of the focal length, by quarters of the boards. Within a
    board errors are alike, as by a rolling shutter, of which OpenCV's own deviations know nothing."""
    import cv2

    others = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
    focals = [_solve(boards[part::4], size, others, found).matrix[0, 0] for part in range(4)]
    return float(np.std(focals, ddof=1)) / 2.0


def _solve(
    boards: np.ndarray, size: tuple[int, int], fixed: int, start: _Calibration | None = None
) -> _Calibration:
    """Calibrate a lens with one focal length, no tangential and no third radial term. What is `fixed` stays
    as in `start`, or without that the principal point is the picture's middle and the distortion 0."""
    import cv2

    across, down = CORNERS
    board = np.zeros((across * down, 3), dtype=np.float32)
    board[:, :2] = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 2)
    guess = 0.8 * max(size)
    matrix: Any = np.array([[guess, 0.0, size[0] / 2.0], [0.0, guess, size[1] / 2.0], [0.0, 0.0, 1.0]])
    distortion: Any = np.zeros(5)
    if start is not None:
        matrix, distortion = start.matrix.copy(), start.distortion.copy()
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    _, matrix, distortion, _, _, sigma, _, errors = cv2.calibrateCameraExtended(
        [board] * len(boards),
        [each[:, None].astype(np.float32) for each in boards],
        size,
        matrix,
        distortion,
        flags=flags | fixed,
        criteria=(_UNTIL, 100, 1e-9),
    )
    return _Calibration(matrix, distortion.ravel(), sigma.ravel(), errors.ravel())
