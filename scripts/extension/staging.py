"""The folder that Blender's own extension tool makes the zip of, that tool, and the zip in a fixed form."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path

from scripts.extension.papers import sbom, third_party_licences
from scripts.extension.wheels import BuildError, Wheel

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = "blender_manifest.toml"
SAME_TIME = (2020, 1, 1, 0, 0, 0)


def stage(folder: Path, platform: str, wheels: Sequence[Wheel]) -> None:
    """Fill the empty `folder`. Raises BuildError where the manifest is not as it is expected to be."""
    addon = ROOT / "blender_manient"
    for file in sorted(addon.rglob("*.py")):
        copy = folder / file.relative_to(addon)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    shutil.copyfile(ROOT / "LICENSE", folder / "LICENSE")
    (folder / "wheels").mkdir()
    for wheel in wheels:
        shutil.copyfile(wheel.path, folder / "wheels" / wheel.path.name)
    text = (ROOT / MANIFEST).read_text(encoding="utf-8")
    manifest = tomllib.loads(text)
    for name, content in (
        (MANIFEST, staged_manifest(text, platform, wheels)),
        ("THIRD_PARTY_LICENSES", third_party_licences(wheels)),
        ("sbom.cdx.json", sbom(manifest["id"], manifest["version"], platform, wheels)),
    ):
        (folder / name).write_text(content, encoding="utf-8", newline="\n")


def staged_manifest(text: str, platform: str, wheels: Sequence[Wheel]) -> str:
    """The manifest with one platform and the wheels. Raises BuildError."""
    text, found = re.subn(
        r"^platforms = \[[^\]]*\]$", f'platforms = ["{platform}"]', text, flags=re.MULTILINE
    )
    before, table, after = text.partition("\n[")
    if found != 1 or not table:
        raise BuildError(f"{MANIFEST}: expected one line `platforms = [...]` before the first table")
    # A key of the top level must stand before the first table.
    listed = "".join(f'  "./wheels/{wheel.path.name}",\n' for wheel in wheels)
    return f"{before.rstrip()}\nwheels = [\n{listed}]\n{table}{after}"


def fix(path: Path) -> None:
    """Rewrite a zip: entries sorted by name, of one time and mode, not compressed.

    Blender's tool writes files as the file system orders them, with their times. Other builds of zlib
    compress to other bytes, and the wheels, nearly all of the zip, are compressed already.
    """
    beside = path.with_name(f".{path.name}")
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(beside, "w") as target:
        for entry in sorted(source.infolist(), key=lambda entry: entry.filename):
            info = zipfile.ZipInfo(entry.filename, SAME_TIME)
            info.file_size = entry.file_size
            info.create_system = 3  # Unix, whose modes these are, on whatever system this runs
            info.external_attr = 0o644 << 16
            with source.open(entry) as content, target.open(info, "w") as copy:
                shutil.copyfileobj(content, copy, 1 << 20)
    beside.replace(path)


def extension_tool() -> list[str]:
    """The command of Blender's extension tool, which is in this Python's bpy wheel. Raises BuildError."""
    spec = importlib.util.find_spec("bpy")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if scripts := sorted(Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")):
            return [sys.executable, "-I", str(scripts[-1])]
    raise BuildError(
        f"{sys.executable}: this Python has no bpy wheel, whose tool makes the zip; run `nox -s build`"
    )


def run_tool(tool: Sequence[str], *arguments: str) -> None:
    """`build` or `validate`. Raises BuildError with what the tool says against it."""
    command = [*tool, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        said = (done.stdout + done.stderr).strip() or f"it ended with {done.returncode} and said nothing"
        raise BuildError(f"Blender's extension tool refused ({' '.join(command)}):\n{said}")
