"""The folder that Blender's tool makes the zip of."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

from scripts.extension import inventory, licences, sbom
from scripts.extension.contents import Contents
from scripts.extension.errors import BuildError

ROOT = Path(__file__).resolve().parents[2]
ADDON = ROOT / "blender_manient"
MANIFEST = ROOT / "blender_manifest.toml"
LICENCE = ROOT / "LICENSE"
WHEELS = "wheels"


def stage(folder: Path, contents: Contents) -> None:
    """Fill the empty `folder`. Raises BuildError where the manifest is not as it is expected to be."""
    for file in sorted(ADDON.rglob("*.py")):
        copy = folder / file.relative_to(ADDON)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    shutil.copyfile(LICENCE, folder / LICENCE.name)
    for name, text in (
        (inventory.FILE_NAME, inventory.inventory(contents)),
        (licences.FILE_NAME, licences.third_party_licences(contents)),
        (sbom.FILE_NAME, sbom.sbom(contents)),
    ):
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    (folder / WHEELS).mkdir()
    for wheel, _ in contents.wheels:
        shutil.copyfile(wheel.path, folder / WHEELS / wheel.path.name)
    text = staged_manifest(MANIFEST.read_text(encoding="utf-8"), contents)
    (folder / MANIFEST.name).write_text(text, encoding="utf-8", newline="\n")


def staged_manifest(text: str, contents: Contents) -> str:
    """The manifest with one platform and the wheels. Raises BuildError."""
    platforms = f'platforms = ["{contents.platform.name}"]'
    text, found = re.subn(r"^platforms = \[[^\]]*\]$", platforms, text, flags=re.MULTILINE)
    before, table, after = text.partition("\n[")
    if found != 1 or not table:
        raise BuildError(f"{MANIFEST}: expected one line `platforms = [...]` before the first table")
    # A key of the top level must stand before the first table.
    wheels = "".join(f'  "./{WHEELS}/{wheel.path.name}",\n' for wheel, _ in contents.wheels)
    result = f"{before.rstrip()}\nwheels = [\n{wheels}]\n{table}{after}"
    tomllib.loads(result)
    return result
