"""What the wheels' licences are, and THIRD_PARTY_LICENSES with their texts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from scripts.extension.contents import Contents
from scripts.extension.wheel_file import WheelFile

FILE_NAME = "THIRD_PARTY_LICENSES"
CORE = "handfit-core"

_NAMES = r"(LICEN[CS]E|NOTICE|COPYING|AUTHORS)[^/]*(?<!\.py)(?<!\.pyc)(?<!\.pyi)"
# SciPy keeps some beside the code that they are for.
_TEXTS = rf"[^/]+\.dist-info/licen[cs]es/.*|(.*/)?{_NAMES}"
_LONGEST_NAME = 60
_CORE_FOLDER = Path(__file__).resolve().parents[2] / "handfit_core"


@dataclass(frozen=True)
class Bundled:
    """What lies inside handfit_core's wheel and is not of this project. `licence` is an SPDX expression,
    `text` the file in handfit_core that has its words."""

    name: str
    version: str
    licence: str
    note: str
    text: str


BUNDLED = (
    Bundled(
        "MediaPipe hand landmark model",
        "0.10.21",
        "Apache-2.0",
        "Copyright The MediaPipe Authors. palm_detection_full.tflite and hand_landmark_full.tflite of the\n"
        "wheel mediapipe 0.10.21, unchanged, in handfit_core/detect/data/hand_landmarker.task.",
        "detect/data/LICENSE-landmark-model.txt",
    ),
    Bundled(
        "Open hand",
        "1",
        "CC0-1.0",
        "A hand model in MANO's file format, made from data of the MakeHuman community (CC0).\n"
        "In handfit_core/hand_model/data/.",
        "hand_model/data/LICENSE-open-hand.md",
    ),
)


_GCC = "GPL-3.0-or-later WITH GCC-exception-3.1"
_OWN_LICENCE = {
    "mediapipe": ("Apache-2.0",),
    "opencv-python-headless": ("Apache-2.0",),
    # Its OpenBLAS holds GCC's runtime on Windows, too, where it is no file of its own.
    "scipy": ("BSD-3-Clause", _GCC),
    "torch": ("BSD-3-Clause",),
}
"""Of packages whose metadata has no SPDX expression, as their licence files have it"""
_LIBRARIES = (
    (r"lib(gfortran|gcc)", _GCC),
    (r"libquadmath", "LGPL-2.1-or-later"),
    (r"libavcodec|opencv_videoio_ffmpeg", "LGPL-2.1-or-later"),  # FFmpeg
    (r"libx26[45]\.", "GPL-2.0-or-later"),
    (r"lib(ssl|crypto)\b.*\.1\.1$", "OpenSSL"),
)
"""Pattern of a library that comes inside a wheel, and its licence: those that ask for more than that their
text is passed on"""


def _expression(wheel: WheelFile) -> str:
    """The SPDX expression of the wheel with the libraries in it; empty where none is known."""
    if declared := wheel.metadata.get("License-Expression"):
        return declared.strip()
    if wheel.name not in _OWN_LICENCE:
        return ""
    files = [member.rpartition("/")[2] for member in wheel.members]
    bundled = [term for pattern, term in _LIBRARIES if any(re.match(pattern, file) for file in files)]
    return " AND ".join(dict.fromkeys((*_OWN_LICENCE[wheel.name], *bundled)))


def licence_name(wheel: WheelFile) -> str:
    """The wheel's licence in a few words: its SPDX expression if one is known, else its metadata's."""
    metadata = wheel.metadata
    if expression := _expression(wheel):
        return expression
    named = (metadata.get("License") or "").strip()
    if named and "\n" not in named and len(named) <= _LONGEST_NAME:
        return named
    classifiers = metadata.get_all("Classifier") or []
    names = [c.split("::")[-1].strip() for c in classifiers if c.startswith("License ::")]
    return " and ".join(names) or "see its licence files"


def is_expression(wheel: WheelFile) -> bool:
    """Whether `licence_name` is an SPDX expression."""
    return bool(_expression(wheel))


def _texts(wheel: WheelFile) -> str:
    """The wheel's licence files, each text once: torch carries some ten times."""
    names: dict[str, list[str]] = {}
    for name, text in wheel.texts(_TEXTS):
        names.setdefault(text.strip(), []).append(name)
    return "".join(
        "\n" + "".join(f"--- {name} ---\n" for name in same) + f"\n{text}\n" for text, same in names.items()
    )


def third_party_licences(contents: Contents) -> str:
    """The file's text. A package whose wheels for two Pythons carry the same texts stands there once."""
    sections: dict[str, list[str]] = {}
    for wheel, _ in contents.wheels:
        if wheel.name == CORE:
            continue
        body = f"Licence: {licence_name(wheel)}\n{_texts(wheel)}"
        heading = f"{wheel.name} {wheel.version}"
        if body not in sections.setdefault(heading, []):
            sections[heading].append(body)
    for part in BUNDLED:
        text = (_CORE_FOLDER / part.text).read_text(encoding="utf-8").strip()
        body = f"Licence: {part.licence}\n\n{part.note}\n\n--- {part.text} ---\n\n{text}\n"
        sections[f"{part.name} {part.version}"] = [body]
    lines = [
        "This zip carries the work of others, unchanged. Its own code is under GPL-3.0-or-later (LICENSE).",
        "",
        *(f"  {heading}" for heading in sections),
        "",
    ]
    for heading, bodies in sections.items():
        lines += ["=" * 100, heading, "=" * 100, *bodies]
    return "\n".join(lines)
