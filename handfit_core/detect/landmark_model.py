"""MediaPipe's landmark model file: where it lies, and how it is assembled from a wheel.

Google serves `hand_landmarker.task` from a bucket that not every machine reaches. The same two
networks lie in an older MediaPipe wheel on the package index (Apache-2.0); a zip that stores them
uncompressed, aligned to 4 bytes, is a working task file.
"""

from __future__ import annotations

import hashlib
import os
import struct
import zipfile
from importlib.metadata import version
from pathlib import Path

from handfit_core.errors import LandmarkModelError
from handfit_core.files import cache_dir, is_file, shown, written_whole

FILE_NAME = "hand_landmarker.task"

WHEEL_REQUIREMENT = "mediapipe==0.10.21"
WHEEL_PLATFORM = "manylinux_2_28_x86_64"
WHEEL_PYTHON = "3.11"
WHEEL_SHA256 = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"

_ENTRIES = (
    ("hand_detector.tflite", "mediapipe/modules/palm_detection/palm_detection_full.tflite"),
    ("hand_landmarks_detector.tflite", "mediapipe/modules/hand_landmark/hand_landmark_full.tflite"),
)
VARIABLE = "HANDFIT_LANDMARK_MODEL"
"""Names the file where no option does"""

_ALIGNMENT = 4
_LOCAL_HEADER_SIZE = 30
_PADDING_FIELD = 0xD935  # the id that Android's zipalign pads with


def landmark_model_path(explicit: str | os.PathLike[str] | None = None) -> Path:
    """The landmark model file to use.

    The first that is given or exists of: `explicit`; `$HANDFIT_LANDMARK_MODEL`; the file bundled
    with this package; the one in the cache folder. Raises LandmarkModelError.
    """
    for named in (explicit, os.environ.get(VARIABLE)):
        if named:
            path = Path(named).expanduser()
            if not is_file(path):
                raise LandmarkModelError(f"{shown(path)}: there is no such landmark model file")
            return path
    for path in (Path(__file__).parent / "data" / FILE_NAME, cached_path()):
        if path.is_file():
            return path
    raise LandmarkModelError(
        f"MediaPipe's landmark model ({FILE_NAME}) was not found; run scripts/fetch_landmark_model.py "
        "once, or name the file with --landmark-model"
    )


def fingerprint(explicit: str | os.PathLike[str] | None = None) -> str:
    """Names the model file and the MediaPipe that runs it. Raises LandmarkModelError."""
    model = hashlib.sha256(landmark_model_path(explicit).read_bytes()).hexdigest()
    return f"{model}|mediapipe {version('mediapipe')}"


def cached_path() -> Path:
    """Where the assembled file is kept between runs."""
    return cache_dir() / FILE_NAME


def assemble(wheel: str | os.PathLike[str], destination: str | os.PathLike[str]) -> Path:
    """Make the task file from the pinned MediaPipe wheel; the same wheel gives the same bytes.

    Raises LandmarkModelError when the wheel is not the pinned one, OutputError when `destination`
    cannot be written.
    """
    wheel, destination = Path(wheel), Path(destination)
    try:
        found = hashlib.sha256(wheel.read_bytes()).hexdigest()
    except OSError as error:
        raise LandmarkModelError(f"{wheel}: cannot be read ({error.strerror})") from error
    if found != WHEEL_SHA256:
        raise LandmarkModelError(
            f"{wheel}: sha256 is {found}, expected {WHEEL_SHA256} ({WHEEL_REQUIREMENT} for Python "
            f"{WHEEL_PYTHON}, {WHEEL_PLATFORM}); download it again"
        )
    with (
        zipfile.ZipFile(wheel) as source,
        written_whole(destination) as beside,
        zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as task,
    ):
        for name, member in _ENTRIES:
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            assert task.fp is not None
            data_start = task.fp.tell() + _LOCAL_HEADER_SIZE + len(name)
            # MediaPipe maps the networks straight from the file; an unaligned one it must copy.
            # The padding is a well-formed extra field (its own 4 bytes keep the alignment), since
            # MediaPipe's zip reader refuses anything else.
            padding = -data_start % _ALIGNMENT
            info.extra = struct.pack("<HH", _PADDING_FIELD, padding) + b"\0" * padding
            task.writestr(info, source.read(member))
    return destination


def landmarks_2020_path() -> Path | None:
    path = cache_dir() / "hand_landmarks_2020.tflite"
    named = os.environ.get("HANDFIT_LANDMARKS_2020")
    return None if named == "none" or not path.is_file() else path
