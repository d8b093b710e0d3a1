"""Tells by its content what a file is that cannot be read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from handfit_core.common.errors import InputError
from handfit_core.media.headers import CONTAINERS, PICTURES
from handfit_core.media.heif import HEIF

_PICTURE: Final = "picture that is cut off or damaged; open it in a viewer and save it again"
_CHOOSE: Final = "choose a photo or a video"
_KINDS: Final = {
    rb"%PDF": "a PDF document; export its page as PNG",
    rb"8BPS": "a Photoshop picture; export it as PNG or JPEG",
    rb"\xff\x0a|\0\0\0\x0cJXL ": "a JPEG XL picture; export it as PNG or JPEG",
    rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51": "a JPEG 2000 picture; export it as PNG or JPEG",
    HEIF: "a HEIC or AVIF photo that is damaged or of an unusual layout; export it as JPEG",
    rb"....ftypcrx |FUJIFILM|II(?:U\0|RO)|FOVb": "a camera's raw picture; develop it and export it as JPEG",
    PICTURES["OpenEXR"]: f"an OpenEXR {_PICTURE}, as RGB with ZIP",
    **{PICTURES[kind]: f"a {kind} {_PICTURE}" for kind in ("JPEG", "PNG", "TIFF", "WebP", "DPX")},
    rb"GIF8": f"a GIF {_PICTURE}",
    rb"BM.{4}\0\0\0\0|P[1-6]\s|#\?R": f"a {_PICTURE}",
    CONTAINERS: "a clip that is cut off, damaged or of an unusual kind; if it plays in a viewer, convert it "
    "to .mp4 (H.264)",
    rb"RIFF....WAVE|ID3|\xff[\xfb\xf3\xf2]|fLaC": f"a sound; {_CHOOSE}",
    rb"PK\x03\x04.{26,99}\.npy": "an archive of NumPy, as hand takes are; have its name end with .npz",
    rb"PK\x03\x04|Rar!|7z\xbc\xaf|\x1f\x8b|\x28\xb5\x2f\xfd": f"packed data; unpack it and {_CHOOSE}",
    rb"BLENDER": "a Blender file; render it and choose the pictures",
    rb"\x7fELF|MZ": f"a program; {_CHOOSE}",
    rb"(?i:\s*(?:<\?xml.{,500})?<svg)": "a drawing of lines (SVG); export it as PNG",
    rb"(?i:\s*<(?:!DOCTYPE )?html)": "a web page in place of a picture; download the file again",
    rb"[\t\n\r\x20-\x7e\x80-\xff]+\Z": f"a text; {_CHOOSE}",
}
"""Kinds of files by their first bytes, as text that says what to do with them; the first that fits counts"""
_UNKNOWN: Final = "data of an unknown kind, or damaged; export it as PNG, JPEG or MP4"


def what_is(path: Path) -> str:
    """Return what a file is and what to do with it, as the end of a sentence. Raises OSError."""
    with open(path, "rb") as stream:
        start = stream.read(4096)
    if not start:
        return "the file is empty (0 bytes); copy or export it again"
    kinds = (kind for pattern, kind in _KINDS.items() if re.match(pattern, start, re.DOTALL))
    return f"this is {next(kinds, _UNKNOWN)}"


def unreadable(path: Path) -> InputError:
    """Return the error to raise for a file that cannot be read as the kind that it should be. Raises
    OSError."""
    return InputError(f"{path}: {what_is(path)}")
