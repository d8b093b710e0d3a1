"""MediaPipe's landmark model files: where they lie, and how they are assembled from packages.

Google serves `hand_landmarker.task` from a bucket that not every machine reaches. The same two
networks lie in an older MediaPipe wheel on the package index (Apache-2.0); a zip that stores them
uncompressed, aligned to 4 bytes, is a working task file.

The landmark network of December 2020 has a better depth. It lies in MediaPipe's npm package of that month
(Apache-2.0), and everything works without it, too. The body networks, of the same wheel, are for arms.
"""

from __future__ import annotations

import hashlib
import logging
import os
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Final

from handfit_core.common.errors import LandmarkModelError
from handfit_core.common.files import cache_dir, is_file, path_of, read_file, shown, written_whole
from handfit_core.detect.tflite import with_image_metadata

log = logging.getLogger("handfit")


@dataclass(frozen=True)
class TaskFile:
    """Where MediaPipe's landmark model is found, and the wheel that it is assembled from."""

    name: str = "hand_landmarker.task"
    sha256: str = "7462e38bc4b5eb36699bb7f406e28e9768e70b0b073e0cf8a8da419ea4b8fa02"
    variable: str = "HANDFIT_LANDMARK_MODEL"
    """Environment variable with the file's path, used where no option gives it"""
    wheel_requirement: str = "mediapipe==0.10.21"
    wheel_platform: str = "manylinux_2_28_x86_64"
    wheel_python: str = "3.11"
    wheel_sha256: str = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"
    entries: tuple[tuple[str, str], tuple[str, str]] = (
        ("hand_detector.tflite", "mediapipe/modules/palm_detection/palm_detection_full.tflite"),
        ("hand_landmarks_detector.tflite", "mediapipe/modules/hand_landmark/hand_landmark_full.tflite"),
    )
    calibrated: tuple[str, str] = (
        "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
        "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
    )
    """SHA-256 of the entries with which the expected errors were calibrated"""


TASK: Final = TaskFile()


@dataclass(frozen=True)
class BodyFile:
    """Where MediaPipe's body networks are found, and where they lie in `TaskFile`'s wheel."""

    name: str = "body_landmarks.task"
    sha256: str = "1a40f1083bec40fd18f62c47b3f0f0f65722445a5cca003e1d96992a40cdd991"
    variable: str = "HANDFIT_BODY_MODEL"
    """Environment variable with another path of that file, or `none` to go without"""
    detector: tuple[str, str] = (
        "pose_detector.tflite",
        "mediapipe/modules/pose_detection/pose_detection.tflite",
    )
    landmarks: tuple[str, str] = (
        "pose_landmarks_detector.tflite",
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
    )
    landmarks_kept: tuple[int, int, int] = (0, 1, 4)
    """Indices of the landmark network's outputs that are kept: all but the segmentation and the heat maps,
    which take three quarters of its time"""


BODY: Final = BodyFile()


@dataclass(frozen=True)
class Network2020:
    """Where the landmark network of December 2020 is found, and where in its package it lies."""

    name: str = "hand_landmarks_2020.tflite"
    sha256: str = "6d47ecb3139c41326d8c3dba3d60f1faedc3d3ac42658972eeb4d334f9405518"
    variable: str = "HANDFIT_LANDMARKS_2020"
    """Environment variable with another path of that file, or `none` to go without"""
    npm_package: str = "@mediapipe/hands"
    npm_version: str = "0.1.1606863095"
    member: str = "package/hands_solution_packed_assets.data"
    within: range = range(3877899, 7670519)
    within_sha256: str = "276abb7cb09c386247ba5b6fc1aa1ebba574a239777c000d5ffb06db997d6ffa"
    max_bytes: int = 100_000_000
    """Most bytes that are read of a file that should be the landmark network of December 2020"""
    outputs: tuple[str, str, str] = ("landmarks", "presence", "handedness")


NETWORK_2020: Final = Network2020()


def landmark_model_path(explicit: str | os.PathLike[str] | None = None) -> Path:
    """Return the path of the landmark model file to use.

    It is the first that is given or exists of: `explicit`; `$HANDFIT_LANDMARK_MODEL`; the file bundled with
    this package; the one in the cache folder. Raises LandmarkModelError where there is none.
    """
    for named in (explicit, os.environ.get(TASK.variable)):
        if named:
            path = Path(named).expanduser()
            if not is_file(path):
                raise LandmarkModelError(f"{shown(path)}: there is no such landmark model file")
            return path
    for path in _files_there(TASK.name):
        return path
    raise LandmarkModelError(
        f"MediaPipe's landmark model ({TASK.name}) was not found; run scripts/fetch_landmark_model.py "
        "once, or name the file with --landmark-model"
    )


def body_model_path() -> Path:
    """Return the path of the body networks' file: `$HANDFIT_BODY_MODEL`, or the one bundled with this package
    or in the cache folder. Raises LandmarkModelError where there is none."""
    named = os.environ.get(BODY.variable)
    for path in [path_of(named)] if named else _files_there(BODY.name):
        if named != "none" and is_file(path):
            return path
    why = f"{BODY.variable} is {named!r}" if named else "they were not found"
    raise LandmarkModelError(
        f"arms need MediaPipe's body networks ({BODY.name}), and {why}; run scripts/fetch_landmark_model.py "
        "once, install the add-on's zip again, or capture without arms"
    )


def fingerprint(explicit: str | os.PathLike[str] | None = None) -> str:
    """Return hashes of the model files and the version of MediaPipe that runs them, as one text. Raises
    LandmarkModelError where the landmark model is missing."""
    model = hashlib.sha256(landmark_model_path(explicit).read_bytes()).hexdigest()
    second = f"|landmarks of 2020 {NETWORK_2020.sha256}" if landmarks_2020_path() else ""
    return f"{model}{second}|mediapipe {version('mediapipe')}"


def landmarks_2020_path() -> Path | None:
    """Return the path of the checked file of the landmark network of December 2020; None to go without it.

    It is the first that is given or exists of: `$HANDFIT_LANDMARKS_2020`; the file bundled with this package;
    the one in the cache folder. A file that is missing, damaged or of another version leads to a warning, and
    to None.
    """
    named = os.environ.get(NETWORK_2020.variable)
    if named == "none":
        return None
    places = [path_of(named)] if named else _files_there(NETWORK_2020.name)
    path = next(iter(places), None)
    return path if path and _is_landmarks_2020(path) else None


@lru_cache
def _is_landmarks_2020(path: Path) -> bool:
    """Return True if a file is the landmark network of December 2020. Warns once where it is not."""
    try:
        found = hashlib.sha256(read_file(path, NETWORK_2020.max_bytes)).hexdigest()
    except OSError as error:
        what = f"it cannot be read ({error.strerror})"
    else:
        if found == NETWORK_2020.sha256:
            return True
        what = "it is damaged, or of another version"
    log.warning(
        "%s: %s, so hands are found without MediaPipe's landmark network of December 2020, which tells depth "
        "better; run scripts/fetch_landmark_model.py, or install the add-on's zip again",
        *(shown(path), what),
    )
    return False


def is_calibrated(explicit: str | os.PathLike[str] | None = None) -> bool:
    """Return True if the model file to use holds the networks with which the expected errors were calibrated,
    wherever it lies and whoever zipped it. Raises LandmarkModelError where there is none."""
    try:
        with zipfile.ZipFile(landmark_model_path(explicit)) as task:
            return all(
                hashlib.sha256(task.read(name)).hexdigest() == known
                for (name, _), known in zip(TASK.entries, TASK.calibrated, strict=True)
            )
    except (OSError, KeyError, zipfile.BadZipFile, RuntimeError, ValueError):
        return False  # Loading it will raise with the reason.


def cached_path(name: str = TASK.name) -> Path:
    """Return the path in the cache folder at which the assembled file of that name is kept between runs."""
    return cache_dir() / name


def _files_there(name: str) -> list[Path]:
    """Return the paths of the files of that name that exist: the one bundled with this package, then the one
    in the cache folder."""
    return list(filter(is_file, (Path(__file__).parent / "data" / name, cached_path(name))))


def assemble(wheel: str | os.PathLike[str], destination: str | os.PathLike[str]) -> Path:
    """Make the task file from the pinned MediaPipe wheel; equal wheels give equal bytes.

    Raises LandmarkModelError when the wheel is not the pinned one, OutputError when `destination`
    cannot be written.
    """
    return _write_task(destination, _of_wheel(wheel, TASK.entries))


def assemble_body(wheel: str | os.PathLike[str], destination: str | os.PathLike[str]) -> Path:
    """Make the file of the body networks from the pinned MediaPipe wheel, with the metadata by which
    MediaPipe runs them; errors are raised as by `assemble`."""
    networks = _of_wheel(wheel, (BODY.detector, BODY.landmarks))
    detector, landmarks = BODY.detector[0], BODY.landmarks[0]
    outputs = ("landmarks", "presence", "world")
    kept = BODY.landmarks_kept
    networks[detector] = with_image_metadata(networks[detector], 127.5, 127.5, ("boxes", "scores"))
    networks[landmarks] = with_image_metadata(networks[landmarks], 0.0, 255.0, outputs, kept)
    return _write_task(destination, networks)


def _of_wheel(wheel: str | os.PathLike[str], entries: Iterable[tuple[str, str]]) -> dict[str, bytes]:
    """Return the members of the pinned MediaPipe wheel by the names that they get. Raises LandmarkModelError
    where the wheel is another one."""
    wheel = Path(wheel)
    try:
        found = hashlib.sha256(wheel.read_bytes()).hexdigest()
    except OSError as error:
        raise LandmarkModelError(f"{wheel}: cannot be read ({error.strerror})") from error
    if found != TASK.wheel_sha256:
        raise LandmarkModelError(
            f"{wheel}: sha256 is {found}, expected {TASK.wheel_sha256} ({TASK.wheel_requirement} for Python "
            f"{TASK.wheel_python}, {TASK.wheel_platform}); download it again"
        )
    with zipfile.ZipFile(wheel) as source:
        return {name: source.read(member) for name, member in entries}


def _write_task(destination: str | os.PathLike[str], networks: Mapping[str, bytes]) -> Path:
    """Write networks into a zip that MediaPipe's tasks can read; returns its path. Raises OutputError where
    it cannot be written."""
    destination = Path(destination)
    with (
        written_whole(destination) as beside,
        zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as task,
    ):
        for name, network in networks.items():
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            assert task.fp is not None
            data_start = task.fp.tell() + 30 + len(name)
            # MediaPipe maps the networks straight from the file; an unaligned one it must copy.
            # The padding is a well-formed extra field (its own 4 bytes keep the alignment), since
            # MediaPipe's zip reader refuses anything else.
            padding = -data_start % 4
            # The id that Android's zipalign pads with
            info.extra = struct.pack("<HH", 0xD935, padding) + b"\0" * padding
            task.writestr(info, network)
    return destination


def assemble_2020(package: str | os.PathLike[str], destination: str | os.PathLike[str]) -> Path:
    """Make the landmark network of December 2020 from MediaPipe's npm package, a .tgz, with the metadata by
    which MediaPipe runs it; equal packages give equal bytes.

    Raises LandmarkModelError when the package is not the pinned one, OutputError when `destination` cannot be
    written.
    """
    package, destination = Path(package), Path(destination)
    wanted = f"{NETWORK_2020.npm_package} {NETWORK_2020.npm_version}"
    try:
        with (
            tarfile.open(package, "r:gz") as source,
            source.extractfile(NETWORK_2020.member) or BytesIO() as member,
        ):
            member.seek(NETWORK_2020.within.start)
            network = member.read(len(NETWORK_2020.within))
    except KeyError as error:
        raise LandmarkModelError(f"{shown(package)}: this is not npm's {wanted}") from error
    except (OSError, EOFError, tarfile.TarError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise LandmarkModelError(f"{shown(package)}: cannot be read as npm's {wanted} ({reason})") from error
    if (found := hashlib.sha256(network).hexdigest()) != NETWORK_2020.within_sha256:
        raise LandmarkModelError(
            f"{shown(package)}: the network's sha256 is {found}, expected {NETWORK_2020.within_sha256} "
            f"({wanted}); download it again"
        )
    made = with_image_metadata(network, 0.0, 255.0, NETWORK_2020.outputs)
    with written_whole(destination) as beside:
        beside.write_bytes(made)
    return destination
