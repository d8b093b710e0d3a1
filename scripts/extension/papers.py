"""The papers of a zip: THIRD_PARTY_LICENSES, and the software bill of materials in CycloneDX 1.6 (JSON).

Both have no time in them: same input, same bytes.
"""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scripts.extension.wheels import PYTHONS, Wheel

CORE = "handfit-core"
_CORE_FOLDER = Path(__file__).resolve().parents[2] / "handfit_core"

BUNDLED = (
    (
        "MediaPipe hand landmark model",
        "0.10.21",
        "Apache-2.0",
        "Copyright The MediaPipe Authors. palm_detection_full.tflite and hand_landmark_full.tflite of the\n"
        "wheel mediapipe 0.10.21, unchanged, in handfit_core/detect/data/hand_landmarker.task.",
        "detect/data/LICENSE-landmark-model.txt",
    ),
    (
        "MediaPipe body networks",
        "0.10.21",
        "Apache-2.0",
        "Copyright The MediaPipe Authors. pose_detection.tflite and pose_landmark_full.tflite of the\n"
        "wheel mediapipe 0.10.21, in handfit_core/detect/data/body_landmarks.task. They were changed:\n"
        "metadata, by which MediaPipe's image embedder runs them, were put before them, and outputs of the\n"
        "second one, segmentation and heat maps, are left out.",
        "detect/data/LICENSE-landmark-model.txt",
    ),
    (
        "MediaPipe hand landmark network of December 2020",
        "0.1.1606863095",
        "Apache-2.0",
        "Copyright The MediaPipe Authors. A network inside hands_solution_packed_assets.data of the npm\n"
        "package @mediapipe/hands, in handfit_core/detect/data/hand_landmarks_2020.tflite. It was changed:\n"
        "metadata, by which MediaPipe's image embedder runs it, were put before it.",
        "detect/data/LICENSE-landmark-model.txt",
    ),
    (
        "Open hand",
        "1",
        "CC0-1.0",
        "A hand model in MANO's file format, made from data of the MakeHuman community (CC0).\n"
        "In handfit_core/hand_model/data/.",
        "hand_model/data/LICENSE-open-hand.md",
    ),
)
"""Works of others inside handfit_core's wheel: name, version, SPDX expression, a note, and the file in
handfit_core with the licence's text."""

_NAMES = r"(LICEN[CS]E|NOTICE|COPYING|AUTHORS)[^/]*(?<!\.py)(?<!\.pyc)(?<!\.pyi)"
# SciPy keeps some beside the code that they are for.
_TEXTS = rf"[^/]+\.dist-info/licen[cs]es/.*|(.*/)?{_NAMES}"
_GCC = "GPL-3.0-or-later WITH GCC-exception-3.1"
_OWN_LICENCE = {
    "cloudpickle": ("BSD-3-Clause",),
    "loky": ("BSD-3-Clause",),
    "mediapipe": ("Apache-2.0",),
    "opencv-python-headless": ("Apache-2.0",),
    # Its OpenBLAS holds GCC's runtime on Windows, too, where it is no file of its own.
    "scipy": ("BSD-3-Clause", _GCC),
    "torch": ("BSD-3-Clause",),
    "tqdm": ("MPL-2.0", "MIT"),
}
"""Package -> the licence in its licence files, where its metadata has no SPDX expression"""
_HELD = {"av": "GPL-3.0-or-later"}
"""Package -> the licence of a library in its wheel: PyAV's FFmpeg is built with parts under this one"""
_LIBRARIES = (
    (r"lib(gfortran|gcc)", _GCC),
    (r"libquadmath", "LGPL-2.1-or-later"),
    (r"libavcodec|opencv_videoio_ffmpeg", "LGPL-2.1-or-later"),  # FFmpeg
    (r"libx26[45]\.", "GPL-2.0-or-later"),
    (r"lib(ssl|crypto)\b.*\.1\.1$", "OpenSSL"),
)
"""Pattern of a library that comes inside a wheel, and its licence: those that ask for more than that their
text is passed on"""


def licence(wheel: Wheel) -> str:
    """The SPDX expression of a wheel with the libraries in it. KeyError where none is known."""
    if declared := wheel.metadata.get("License-Expression"):
        return " AND ".join(filter(None, (declared.strip(), _HELD.get(wheel.name))))
    files = [member.rpartition("/")[2] for member in wheel.members]
    bundled = [term for pattern, term in _LIBRARIES if any(re.match(pattern, file) for file in files)]
    return " AND ".join(dict.fromkeys((*_OWN_LICENCE[wheel.name], *bundled)))


def third_party_licences(wheels: Sequence[Wheel]) -> str:
    """The file's text. A package whose wheels for two Pythons carry the same texts stands there once."""
    sections: dict[str, list[str]] = {}
    for wheel in wheels:
        if wheel.name != CORE:
            texts: dict[str, str] = {}  # torch carries some of them ten times
            for name, text in wheel.texts(_TEXTS):
                texts[text.strip()] = texts.get(text.strip(), "") + f"--- {name} ---\n"
            body = f"Licence: {licence(wheel)}\n" + "".join(f"\n{n}\n{t}\n" for t, n in texts.items())
            bodies = sections.setdefault(f"{wheel.name} {wheel.version}", [])
            bodies += [body] if body not in bodies else []
    for name, version, named, note, file in BUNDLED:
        text = (_CORE_FOLDER / file).read_text(encoding="utf-8").strip()
        sections[f"{name} {version}"] = [f"Licence: {named}\n\n{note}\n\n--- {file} ---\n\n{text}\n"]
    lines = [
        "This zip carries the work of others, unchanged but where a change is named. Its own code is under",
        "GPL-3.0-or-later (LICENSE).",
        "",
        *(f"  {heading}" for heading in sections),
        "",
    ]
    for heading, bodies in sections.items():
        lines += ["=" * 100, heading, "=" * 100, *bodies]
    return "\n".join(lines)


def sbom(identity: str, version: str, platform: str, wheels: Sequence[Wheel]) -> str:
    """The bill of materials; its serial number is made from its content."""
    root = f"{identity}@{version}"
    parts = [_component(wheel) for wheel in wheels]
    bundled = [
        {
            "type": "data",
            "bom-ref": name.lower().replace(" ", "-"),
            "name": name,
            "version": number,
            "licenses": [{"license": {"id": named}}],
        }
        for name, number, named, *_ in BUNDLED
    ]
    core = next(part["bom-ref"] for part in parts if part["name"] == CORE)
    document: dict[str, Any] = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": identity,
                "version": version,
                "licenses": [{"license": {"id": "GPL-3.0-or-later"}}],
                "properties": [
                    {"name": "manient:platform", "value": platform},
                    {"name": "manient:pythons", "value": " ".join(PYTHONS)},
                ],
            }
        },
        "components": parts + bundled,
        "dependencies": [
            {"ref": root, "dependsOn": [part["bom-ref"] for part in parts]},
            {"ref": core, "dependsOn": [part["bom-ref"] for part in bundled]},
        ],
    }
    document["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_OID, json.dumps(document, sort_keys=True)).urn
    return json.dumps(document, indent=2) + "\n"


def _component(wheel: Wheel) -> dict[str, Any]:
    version, file = (text.replace("+", "%2B") for text in (wheel.version, wheel.path.name))
    # handfit_core is on no index, and somebody else could take its name there.
    purl = {} if wheel.name == CORE else {"purl": f"pkg:pypi/{wheel.name}@{version}?file_name={file}"}
    return {
        "type": "library",
        "bom-ref": wheel.path.name,
        "name": wheel.name,
        "version": wheel.version,
        **purl,
        "hashes": [{"alg": "SHA-256", "content": wheel.sha256}],
        "licenses": [{"expression": licence(wheel)}],
    }
