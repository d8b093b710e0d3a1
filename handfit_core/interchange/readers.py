"""Readers of other programs' files, found by name or by what they recognise.

Those of other packages are found by their entry points of the group `handfit.readers` (see `registry`), and
a user's own as files in the folder `layouts` of `data_dir`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from handfit_core.common.errors import InputError
from handfit_core.common.files import shown
from handfit_core.common.registry import Registry
from handfit_core.interchange.document import Document
from handfit_core.interchange.recording import ReadOptions, Recording


@dataclass(frozen=True)
class Reader:
    """One format of hands or keypoints."""

    title: str
    """The format's own name, for people"""
    layout: str
    """A phrase for such a file, for messages and lists"""
    recognises: Callable[[Document], bool]
    """True if a file or folder is of this format, by its contents rather than its name. Raises nothing for
    files of other formats, however damaged"""
    read: Callable[[Document, ReadOptions], Recording]
    """Reads a file or folder of this format. Raises InputError, whose sentence says what was found and what
    was expected, and OptionError for an option without which it cannot be read"""
    met: str = ""
    """The real file that it was tried with: project and date; empty: it was written by the description"""
    assumed: str = ""
    """Assumptions about every such file, for the table of docs/interchange.md"""


_HERE: Final = "handfit_core.interchange.formats"
READERS: Final = Registry(
    "handfit.readers",
    "format",
    Reader,
    {
        "points": f"{_HERE}.keypoints:POINTS.reader",
        "bvh": f"{_HERE}.bvh:READER",
        "hand-tracking": f"{_HERE}.hand_tracking:HAND_TRACKING.reader",
        "leap": f"{_HERE}.keypoints:LEAP.reader",
        "sam3d-body": f"{_HERE}.sam3d_body:READER",
        "openpose": f"{_HERE}.keypoints:OPENPOSE.reader",
        "mmpose": f"{_HERE}.keypoints:MMPOSE.reader",
        "coco-wholebody": f"{_HERE}.keypoints:COCO.reader",
        "alphapose": f"{_HERE}.keypoints:ALPHAPOSE.reader",
        "interhand": f"{_HERE}.keypoints:INTERHAND.reader",
        "aria": f"{_HERE}.keypoints:ARIA.reader",
        "hawor": f"{_HERE}.mano:HAWOR.reader",
        "dyn-hamr": f"{_HERE}.mano:DYN_HAMR.reader",
        "smplx": f"{_HERE}.mano:SMPLX.reader",
        "hot3d": f"{_HERE}.mano:HOT3D.reader",
        "arctic": f"{_HERE}.mano:ARCTIC.reader",
        "grab": f"{_HERE}.mano:GRAB.reader",
        "interhand-mano": f"{_HERE}.mano:INTERHAND.reader",
        "dexycb": f"{_HERE}.mano:DEXYCB.reader",
        "ho3d": f"{_HERE}.mano:HO3D.reader",
        "freihand": f"{_HERE}.mano:FREIHAND.reader",
        "smplx-keywords": f"{_HERE}.mano:SMPLX_KEYWORDS.reader",
        "hamer": f"{_HERE}.mano:HAMER.reader",
        "wilor-mini": f"{_HERE}.mano:WILOR_MINI.reader",
        "points-table": f"{_HERE}.keypoints:POINTS_TABLE.reader",
        "freemocap": f"{_HERE}.keypoints:FREEMOCAP.reader",
        "apple-vision": f"{_HERE}.keypoints:APPLE_VISION.reader",
        "pose-format": f"{_HERE}.pose_format:POSE_FORMAT.reader",
        "trc": f"{_HERE}.keypoints:TRC.reader",
        "xr-points": f"{_HERE}.keypoints:XR_POINTS.reader",
        "arrays": f"{_HERE}.keypoints:ARRAYS.reader",
        "mediapipe": f"{_HERE}.keypoints:MEDIAPIPE.reader",
    },
    "layouts",
)
"""The readers by their names on the command line, the more particular ones first, which are asked after those
of users and of other packages. MediaPipe's comes last: it takes whatever has 21 points a hand"""


def recognised(document: Document, name: str | None = None) -> tuple[str, Reader]:
    """Return the name of the reader of a document, and the reader. Raises InputError where none recognises
    it, OptionError for a name that there is not."""
    if name is not None:
        return name, READERS.get(name)
    ours = READERS.built_in()
    for known, reader in sorted(READERS.all().items(), key=lambda named: named[0] in ours):
        with READERS.blamed(known):
            if reader.recognises(document):
                return known, reader
    raise InputError(
        f"{shown(document.path)}: no hands of a layout that is known are in it: it is {document.found} "
        "(docs/interchange.md lists what is read; --reader names a layout, where one fits after all)"
    )


BY_DESCRIPTION: Final = "by its description, and on no file of that program: look whether it is right"
"""The note on formats that were tried with no real file"""


def tried_with(recording: Recording) -> str:
    """Return the real file that the reader of a recording was tried with; empty for readers of other
    packages."""
    if recording.format not in READERS.built_in():
        return ""
    return READERS.get(recording.format).met or BY_DESCRIPTION


def program_of(recording: Recording) -> str:
    """Return the name of the program that found the recording's hands: its format's title, else the format's
    name."""
    reader = READERS.all().get(recording.format)
    return recording.format if reader is None else reader.title
