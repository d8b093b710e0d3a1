"""A zip like the real ones, with wheels of a few bytes: the add-on and handfit_core are this checkout's, the
packages that capture are empty."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

from blender_manient.common.installation import this_platform, this_python

ROOT = Path(__file__).resolve().parents[2]
PLATFORM = this_platform()
PYTHON = this_python()
_TAGS = {"linux": "manylinux_2_17_x86_64", "windows": "win_amd64", "macos": "macosx_11_0_arm64"}
FOREIGN = "windows-x64" if PLATFORM == "linux-x64" else "linux-x64"
"""Some other platform"""


def small_zip(
    path: Path,
    *,
    version: str = "0.1.0",
    damage: dict[str, Callable[[bytes], bytes | None]] | None = None,
    platform: str = PLATFORM,
    pythons: tuple[str, ...] = (PYTHON,),
    mark: str = "",
) -> Path:
    """Write it; the wheels say that they are for `platform` and `pythons`.

    `mark`: what MARK is in every module, to tell zips of one version from each other.
    `damage`: name of a package -> what becomes of its wheel after it was listed; None leaves it out.
    """
    tags = {p: f"cp{p.replace('.', '')}" for p in pythons}
    system = _TAGS[platform.partition("-")[0]]
    last_line = f"MARK = {mark!r}\n".encode() if mark else b""
    wheels = [(_core_wheel(version, last_line), "handfit-core", version, pythons)]
    wheels.append((_wheel("mediapipe", "0.10.31", f"py3-none-{system}"), "mediapipe", "0.10.31", pythons))
    for python, tag in tags.items():
        wheels.append((_wheel("scipy", "1.11.4", f"{tag}-{tag}-{system}"), "scipy", "1.11.4", (python,)))
    listed = [
        {"file": name, "name": package, "version": number, "size": len(content), "pythons": list(fits)}
        for (name, content), package, number, fits in wheels
    ]
    contents = {
        "version": version,
        "platform": platform,
        "pythons": list(pythons),
        "wheels": listed,
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("blender_manifest.toml", _manifest(version, platform, [e["file"] for e in listed]))
        archive.writestr("wheels.json", json.dumps(contents))
        for file in sorted((ROOT / "blender_manient").rglob("*.py")):
            name = file.relative_to(ROOT / "blender_manient").as_posix()
            archive.writestr(name, file.read_bytes() + last_line)
        for (name, content), package, *_ in wheels:
            kept = (damage or {}).get(package, bytes)(content)
            if kept is not None:
                archive.writestr(f"wheels/{name}", kept)
    return path


def one_byte_changed(wheel: bytes) -> bytes:
    """Somewhere inside a file of the wheel, whose list of files stays readable."""
    return wheel[:60] + bytes([wheel[60] ^ 1]) + wheel[61:]


def cut_short(wheel: bytes) -> bytes:
    """As after a broken download: no list of files any more."""
    return wheel[: len(wheel) // 2]


def gone(_wheel: bytes) -> None:
    """Not in the zip at all."""


def _manifest(version: str, platform: str, files: list[str]) -> str:
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    lines = [f"wheels = {json.dumps([f'./wheels/{file}' for file in files])}", f'platforms = ["{platform}"]']
    kept = []
    for line in text.partition("\n[")[0].splitlines():
        if line.startswith(("platforms", "wheels")):
            continue
        kept.append(f'version = "{version}"' if line.startswith("version") else line)
    return "\n".join([*kept, *lines, "\n[" + text.partition("\n[")[2]])


def _core_wheel(version: str, last_line: bytes) -> tuple[str, bytes]:
    files = {
        path.relative_to(ROOT).as_posix(): path.read_bytes() + (last_line if path.suffix == ".py" else b"")
        for path in sorted((ROOT / "handfit_core").rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }
    return _packed("handfit_core", version, "py3-none-any", files)


def _wheel(name: str, version: str, tag: str) -> tuple[str, bytes]:
    return _packed(name, version, tag, {f"{name}/__init__.py": f"# {'x' * 200}\n".encode()})


def _packed(name: str, version: str, tag: str, files: dict[str, bytes]) -> tuple[str, bytes]:
    info = f"{name}-{version}.dist-info"
    pure = "true" if tag.endswith("any") else "false"
    files = {
        **files,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n".encode(),
        f"{info}/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: {pure}\nTag: {tag}\n".encode(),
    }
    record = [f"{path},sha256={_digest(data)},{len(data)}" for path, data in files.items()]
    record.append(f"{info}/RECORD,,")
    files[f"{info}/RECORD"] = "\n".join(record).encode() + b"\n"
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for path, data in files.items():
            archive.writestr(path, data)
    return f"{name}-{version}-{tag}.whl", packed.getvalue()


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
