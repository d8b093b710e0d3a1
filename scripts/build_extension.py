#!/usr/bin/env python3
"""Build the add-on's zip for Blender: Edit > Preferences > Get Extensions > Install from Disk.

    python scripts/build_extension.py [--output DIR]        # default: out/extension

The zip has blender_manifest.toml, the add-on, and handfit_core as a wheel. What captures (torch, SciPy,
OpenCV, MediaPipe, the landmark model) is not in it: name a Python that has these in the add-on's preferences.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ADDON = ROOT / "blender_manient"
MANIFEST = ROOT / "blender_manifest.toml"
SAME_TIME = (2020, 1, 1, 0, 0, 0)
"""of all files in the zip, so that the same input gives the same bytes"""


def main() -> int:
    """Build; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the add-on's zip for Blender.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "extension", metavar="DIR")
    output: Path = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    print(build(output))
    return 0


def build(output: Path) -> Path:
    """Write the zip into the folder `output`; returns its path."""
    manifest = MANIFEST.read_text(encoding="utf-8")
    entries = tomllib.loads(manifest)
    with tempfile.TemporaryDirectory() as folder:
        wheel = _core_wheel(Path(folder))
        # A key of the top level must stand before the first table.
        before, table, after = manifest.partition("\n[")
        manifest = f'{before}\nwheels = ["./wheels/{wheel.name}"]\n{table}{after}'
        path = output / f"{entries['id']}-{entries['version']}.zip"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            _add(archive, MANIFEST.name, manifest.encode())
            _add(archive, "LICENSE", (ROOT / "LICENSE").read_bytes())
            _add(archive, f"wheels/{wheel.name}", wheel.read_bytes())
            for file in sorted(ADDON.rglob("*.py")):
                _add(archive, file.relative_to(ADDON).as_posix(), file.read_bytes())
    return path


def _core_wheel(folder: Path) -> Path:
    """handfit_core as a wheel, built from a copy: setuptools leaves files beside the source, and takes in
    what it finds there the next time."""
    source = folder / "source"
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "handfit_core", source / "handfit_core", ignore=without)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder)]
    # setuptools takes the wheel's times from there.
    subprocess.run([*command, str(source)], check=True, env={**os.environ, "SOURCE_DATE_EPOCH": "1577836800"})
    return next(folder.glob("*.whl"))


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    info = zipfile.ZipInfo(name, SAME_TIME)
    info.compress_type = zipfile.ZIP_DEFLATED
    info.external_attr = 0o644 << 16
    archive.writestr(info, content)


if __name__ == "__main__":
    sys.exit(main())
