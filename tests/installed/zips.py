"""Other zips, made of the built one: lighter, of another version, and broken in several ways."""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

MANIFEST = "blender_manifest.toml"
CONTENTS = "wheels.json"
SMALL = ("handfit-core", "mediapipe")
"""Small wheels, with which the add-on itself runs; not without NumPy, which Blender has"""
Files = dict[str, bytes]


def write(files: Files, path: Path) -> Path:
    """A zip of these files, stored as they are."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def light(path: Path, keep: tuple[str, ...] = SMALL) -> Files:
    """The files of the built zip as if it had only the wheels `keep`, and needed no more."""
    with zipfile.ZipFile(path) as archive:
        contents = json.loads(archive.read(CONTENTS))
        dropped = {f"wheels/{wheel['file']}" for wheel in contents["wheels"] if wheel["name"] not in keep}
        files = {name: archive.read(name) for name in archive.namelist() if name not in dropped}
    contents["wheels"] = [wheel for wheel in contents["wheels"] if wheel["name"] in keep]
    files[CONTENTS] = json.dumps(contents).encode()
    for name in dropped:
        unlist(files, name)
    return files


def unlist(files: Files, name: str) -> None:
    """Take a wheel out of the manifest, as a zip has it that was made without it."""
    line = f'  "./{name}",\n'
    text = files[MANIFEST].decode()
    assert line in text, text
    files[MANIFEST] = text.replace(line, "").encode()


def wheel_of(files: Files, package: str) -> str:
    """The name in the zip of a package's wheel."""
    wheels = json.loads(files[CONTENTS])["wheels"]
    return next(f"wheels/{wheel['file']}" for wheel in wheels if wheel["name"] == package)


def change_byte(files: Files, name: str, inside: str) -> None:
    """Change one byte in the middle of the file `inside` of the wheel `name`."""
    content = bytearray(files[name])
    content[place_of(content, inside)] ^= 0x10
    files[name] = bytes(content)


def place_of(content: bytes | bytearray, name: str) -> int:
    """Where the middle of a file of a zip lies in the zip's bytes."""
    with zipfile.ZipFile(io.BytesIO(bytes(content))) as archive:
        info = archive.getinfo(name)
    start = info.header_offset + 30
    names = int.from_bytes(content[start - 4 : start - 2], "little")
    extra = int.from_bytes(content[start - 2 : start], "little")
    return start + names + extra + info.compress_size // 2


def rename_wheel(files: Files, old: str, new: str) -> None:
    """Give a wheel another name, everywhere."""
    files[new] = files.pop(old)
    for name in (MANIFEST, CONTENTS):
        text = files[name].decode()
        assert Path(old).name in text, name
        files[name] = text.replace(Path(old).name, Path(new).name).encode()


def change_contents(files: Files, **values: Any) -> None:
    """Other values in wheels.json."""
    files[CONTENTS] = json.dumps({**json.loads(files[CONTENTS]), **values}).encode()


def set_manifest(files: Files, key: str, value: str) -> None:
    """Another value of a key of the manifest's top level, as TOML."""
    text, count = re.subn(rf"^{key} = .*$", f"{key} = {value}", files[MANIFEST].decode(), flags=re.MULTILINE)
    assert count == 1, key
    files[MANIFEST] = text.encode()


def as_version(files: Files, version: str) -> None:
    """The same add-on under another version: in the manifest, wheels.json, and handfit_core's wheel."""
    old, core = json.loads(files[CONTENTS])["version"], wheel_of(files, "handfit-core")
    other = core.replace(f"-{old}-", f"-{version}-")
    rename_wheel(files, core, other)
    files[other] = _wheel_as_version(files[other], old, version)
    set_manifest(files, "version", f'"{version}"')
    wheels = json.loads(files[CONTENTS])["wheels"]
    for wheel in wheels:
        if wheel["name"] == "handfit-core":
            digest = hashlib.sha256(files[other]).hexdigest()
            wheel |= {"version": version, "sha256": digest, "size": len(files[other])}
    change_contents(files, version=version, wheels=wheels)


def _wheel_as_version(content: bytes, old: str, new: str) -> bytes:
    result, folder = io.BytesIO(), f"handfit_core-{old}.dist-info/"
    with zipfile.ZipFile(io.BytesIO(content)) as before, zipfile.ZipFile(result, "w") as after:
        for name in before.namelist():
            data = before.read(name)
            if name.startswith(folder):
                data = data.replace(old.encode(), new.encode())
            after.writestr(name.replace(folder, f"handfit_core-{new}.dist-info/"), data)
    return result.getvalue()
