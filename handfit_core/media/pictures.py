"""Photos and image sequences: any picture as upright 8-bit RGB."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.media.exif import read_orientation, upright
from handfit_core.media.ffmpeg_pictures import decoded_by_ffmpeg
from handfit_core.media.headers import PICTURES
from handfit_core.media.kinds import unreadable
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import Limit, check_picture, common_limit
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source, SourceKind, Wanted

log = logging.getLogger("handfit")

_WHITE16: Final = 65535.0


def read_picture(
    path: Path,
    *,
    as_stored: bool = False,
    max_megapixels: float | Limit | None = None,
    whites: dict[str, float] | None = None,
) -> tuple[np.ndarray, int]:
    """Read any photo as upright (H, W, 3) uint8 RGB, and the EXIF orientation that was undone.

    `as_stored` leaves the orientation alone, for pictures whose labels are in stored pixels. Alpha is laid
    over mid grey. 16-bit and scene-linear float pictures are brought to 8 bits, and into range where they lie
    far from it. `max_megapixels` is the limit of its size; None: the default of `size_limit`. `whites`: which
    number is white in all pictures of a sequence, by the kind of numbers; filled by the first picture. Raises
    InputError.
    """
    check_picture(path, max_megapixels)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    pixels, orientation = _decoded(path, data)
    white, kind = 1.0, pixels.dtype.kind
    if pixels.dtype != np.uint8:
        whites = {} if whites is None else whites
        white = whites[kind] if kind in whites else _white(path, pixels)
        whites[kind] = white
    if as_stored:
        orientation = 1
    rgb = _rgb8(pixels, white)
    if not re.match(PICTURES["TIFF"], data):  # OpenCV turns a TIFF upright itself
        rgb = upright(rgb, orientation)
    return np.ascontiguousarray(rgb), orientation


def _decoded(path: Path, data: bytes) -> tuple[np.ndarray, int]:
    """Return a picture's pixels as stored, (H, W) or (H, W, 1 to 4) of any depth with colours in the order
    BGR, and the EXIF orientation to undo."""
    import cv2

    if found := decoded_by_ffmpeg(path, data):
        return found
    try:
        # From memory, since OpenCV cannot open paths that are not ASCII on Windows.
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        # OpenCV refuses more than 2^30 pixels.
        raise InputError(f"{path}: the picture is too large or damaged; save it again, smaller") from error
    if pixels is None:
        raise unreadable(path)
    return pixels, read_orientation(data)


def _white(path: Path, pixels: np.ndarray) -> float:
    """Return the value that becomes white: the largest of 16 bits, or 1 of floats. Where the picture's values
    lie far from that it is taken from them, with a warning."""
    step = max(1, math.isqrt(pixels.shape[0] * pixels.shape[1] // MEDIA.exposure_pixels))
    values = pixels[::step, ::step].astype(np.float64)
    values = values[..., : 3 if values.shape[-1] > 2 else 1] if values.ndim == 3 else values
    values = values[np.isfinite(values) & (values > 0)]
    if pixels.dtype == np.uint16:
        bits = int(np.percentile(values, 99.9)).bit_length() if len(values) else 16
        if bits > 12 and bits != 14:  # sensors have 10, 12 or 14
            return _WHITE16
        log.warning("%s: uses %d of its 16 bits; it is made as bright as if it used all", path, bits)
        return 2.0**bits - 1
    values = values[values > np.percentile(values, 99.9) / 1000] if len(values) else values
    bright = float(np.percentile(values, 95)) if len(values) else 1.0
    if MEDIA.darkest <= bright <= MEDIA.brightest:
        return 1.0
    white = bright / 0.8
    log.warning("%s: its linear values reach about %g, which is made white", path, float(f"{white:.2g}"))
    return white


def _rgb8(pixels: np.ndarray, white: float) -> np.ndarray:
    """Turn the pixels that `_decoded` gives, in which the value `white` is white, into (H, W, 3) uint8 RGB,
    in place where they have that form."""
    in_place = pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 3
    rgb = pixels if in_place else np.empty((*pixels.shape[:2], 3), dtype=np.uint8)
    for first in range(0, len(pixels), MEDIA.rows_at_once):
        rows = slice(first, first + MEDIA.rows_at_once)
        rgb[rows] = _rows_rgb8(pixels[rows], white)
    return rgb


def _to_8_bits(values: np.ndarray, white: float, *, curved: bool) -> np.ndarray:
    if values.dtype == np.uint16 and white == _WHITE16:
        return (values >> 8).astype(np.uint8)
    scaled = np.clip(np.nan_to_num(values.astype(np.float32) / np.float32(white)), 0.0, 1.0)
    if values.dtype != np.uint16 and curved:
        scaled = np.where(scaled <= 0.0031308, 12.92 * scaled, 1.055 * scaled ** (1 / 2.4) - 0.055)
    return np.round(255.0 * scaled).astype(np.uint8)


def _rows_rgb8(pixels: np.ndarray, white: float) -> np.ndarray:
    import cv2

    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.dtype != np.uint8:
        colours, alpha = np.split(pixels, [(pixels.shape[2] - 1) // 2 * 2 + 1], axis=2)
        opaque = _WHITE16 if pixels.dtype == np.uint16 else 1.0
        pixels = np.concatenate(
            [_to_8_bits(colours, white, curved=True), _to_8_bits(alpha, opaque, curved=False)], axis=2
        )
    if pixels.shape[2] == 2:  # grey and alpha
        pixels = pixels[..., (0, 0, 0, 1)]
    if pixels.shape[2] == 4 and pixels[..., 3].min() < 255:
        alpha = pixels[..., 3:].astype(np.uint16)
        over_grey = (pixels[..., :3] * alpha + 128 * (255 - alpha) + 127) // 255
        pixels = over_grey.astype(np.uint8)
    # Not by NumPy's indexing, which takes as long as decoding does.
    to_rgb = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}[pixels.shape[2]]
    return cv2.cvtColor(pixels, to_rgb)


def _absolute(files: Sequence[Path]) -> tuple[str, ...]:
    """Return the files' absolute paths; folders are resolved once, since there may be a hundred thousand
    files."""
    folders: dict[str, str] = {}
    found: list[str] = []
    for file in files:
        folder = str(file).removesuffix(file.name)
        if folder not in folders:
            folders[folder] = str(file.parent.resolve() / "_")[:-1]
        found.append(folders[folder] + file.name)
    return tuple(found)


class Pictures(Media):
    """A photo or an image sequence."""

    def __init__(
        self,
        numbered: list[tuple[int, Path]],
        wanted: Wanted,
        *,
        kind: SourceKind,
        all_numbers: Sequence[int] = (),
    ) -> None:
        """Open a sequence of `numbered` pictures; `all_numbers` are those of all its pictures, if there are
        others than the `numbered` ones."""
        self._files, self._numbers = files, numbers = [f for _, f in numbered], [n for n, _ in numbered]
        self._all_numbers = all_numbers or numbers
        self._max_megapixels = common_limit(files, wanted.max_megapixels)
        self._whites: dict[str, float] = {}
        frames = wanted.frames
        self._first_number = frames.first if frames.first is not None else numbers[0]
        self.fps = DEFAULT_FPS
        self.expected_frames = len(files)
        self.first_and_last = numbers[0], numbers[-1]
        # The first picture that can be read decides the size; unreadable ones become empty frames.
        first_file, first, orientation = self._first_readable()
        self._read_already = {first_file: first}
        self.height, self.width = first.shape[:2]
        self.source = Source(kind=kind, files=_absolute(files), orientation=orientation)

    def _first_readable(self) -> tuple[Path, np.ndarray, int]:
        errors: list[InputError] = []
        for file in self._files:
            try:
                return file, *self._read(file)
            except InputError as error:
                errors.append(error)
        raise errors[0]

    def _read(self, file: Path) -> tuple[np.ndarray, int]:
        return read_picture(file, max_megapixels=self._max_megapixels, whites=self._whites)

    def numbers(self, first: int = 0, count: int | None = None) -> Sequence[int]:
        """Return the frame numbers of the wanted pictures, see `Media`."""
        return self._numbers[first:][:count]

    def all_numbers(self) -> Sequence[int]:
        """Return the frame numbers of all pictures of the sequence."""
        return self._all_numbers

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield the pictures in order, see `Media`. Pictures that cannot be read, or have another size than
        the first, come as frames without a picture."""
        chosen = zip(self.numbers(first, count)[::step], self._files[first:][:count][::step], strict=True)
        for number, file in chosen:
            # Taken out, so that it does not stay in memory.
            rgb = self._read_already.pop(file, None)
            try:
                if rgb is None:
                    rgb, _ = self._read(file)
                if rgb.shape[:2] != (self.height, self.width):
                    is_size = f"{rgb.shape[1]} x {rgb.shape[0]}"
                    rgb = None
                    raise InputError(
                        f"{file}: is {is_size} pixels, and the first picture {self.width} x {self.height}"
                    )
            except InputError as error:
                log.warning("%s; frame %d is left empty", error, number)
            yield Frame(number, (number - self._first_number) / self.fps, rgb)
