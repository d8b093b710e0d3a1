"""What the wheels' licences are, and THIRD_PARTY_LICENSES with their texts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scripts.extension.contents import Contents
from scripts.extension.wheel_file import WheelFile

FILE_NAME = "THIRD_PARTY_LICENSES"
CORE = "handfit-core"

_TEXTS = r"[^/]+\.dist-info/(licen[cs]es/.*|(LICEN[CS]E|NOTICE|COPYING|AUTHORS)[^/]*)"
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


def licence_name(wheel: WheelFile) -> str:
    """The wheel's licence in a few words: its SPDX expression if it has one, else what its metadata says."""
    metadata = wheel.metadata
    if expression := metadata.get("License-Expression"):
        return expression.strip()
    named = (metadata.get("License") or "").strip()
    if named and "\n" not in named and len(named) <= _LONGEST_NAME:
        return named
    classifiers = metadata.get_all("Classifier") or []
    names = [c.split("::")[-1].strip() for c in classifiers if c.startswith("License ::")]
    return " and ".join(names) or "see its licence files"


def is_expression(wheel: WheelFile) -> bool:
    """Whether `licence_name` is an SPDX expression."""
    return bool(wheel.metadata.get("License-Expression"))


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
