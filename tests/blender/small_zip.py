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

ROOT = Path(__file__).resolve().parents[2]


def small_zip(
    path: Path,
    *,
    version: str = "0.1.0",
    damage: dict[str, Callable[[bytes], bytes | None]] | None = None,
    mark: str = "",
) -> Path:
    """Write it.

    `mark`: what MARK is in every module, to tell zips of one version from each other.
    `damage`: name of a package -> what becomes of its wheel; None leaves it out.
    """
    last_line = f"MARK = {mark!r}\n".encode() if mark else b""
    wheels = {"handfit-core": _core_wheel(version, last_line), "mediapipe": _wheel("mediapipe", "0.10.31")}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("blender_manifest.toml", _manifest(version, [name for name, _ in wheels.values()]))
        for file in sorted((ROOT / "blender_manient").rglob("*.py")):
            name = file.relative_to(ROOT / "blender_manient").as_posix()
            archive.writestr(name, file.read_bytes() + last_line)
        for package, (name, content) in wheels.items():
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


def _manifest(version: str, files: list[str]) -> str:
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    top, _, tables = text.partition("\n[")
    lines = [f'version = "{version}"' if line.startswith("version") else line for line in top.splitlines()]
    return "\n".join([*lines, f"wheels = {json.dumps([f'./wheels/{file}' for file in files])}", f"[{tables}"])


def _core_wheel(version: str, last_line: bytes) -> tuple[str, bytes]:
    files = {
        path.relative_to(ROOT).as_posix(): path.read_bytes() + (last_line if path.suffix == ".py" else b"")
        for path in sorted((ROOT / "handfit_core").rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }
    return _packed("handfit_core", version, files)


def _wheel(name: str, version: str) -> tuple[str, bytes]:
    return _packed(name, version, {f"{name}/__init__.py": f"# {'x' * 200}\n".encode()})


def _packed(name: str, version: str, files: dict[str, bytes]) -> tuple[str, bytes]:
    info = f"{name}-{version}.dist-info"
    files = {
        **files,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n".encode(),
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = [f"{path},sha256={_digest(data)},{len(data)}" for path, data in files.items()]
    record.append(f"{info}/RECORD,,")
    files[f"{info}/RECORD"] = "\n".join(record).encode() + b"\n"
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for path, data in files.items():
            archive.writestr(path, data)
    return f"{name}-{version}-py3-none-any.whl", packed.getvalue()


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
