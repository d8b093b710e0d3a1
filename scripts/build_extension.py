#!/usr/bin/env python3
"""Build the add-on's zip for Blender: Edit > Preferences > Get Extensions > Install from Disk.

    nox -s build                                         # for this machine's platform
    nox -s build -- --platform linux-x64,windows-x64,macos-arm64
    nox -s build -- --torch cpu                          # with torch, for the paper's experiments

The zip has the add-on, and as wheels handfit_core, with the open hand and the landmark model in it, and all
that it imports, for each Python. The wheels are those of the locks (scripts/extension/locks/), unmodified;
they are downloaded once, into the user's cache. The same input gives the same bytes.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts.needed import need

need("numpy", "nox -s build")

from handfit_core.common.errors import HandfitError
from handfit_core.common.files import written_whole
from handfit_core.common.version import __version__
from scripts.extension.core_wheel import core_wheel
from scripts.extension.papers import licence
from scripts.extension.staging import extension_tool, fix, run_tool, stage
from scripts.extension.wheels import PLATFORMS, PYTHONS, BuildError, Wheel, locked_wheels, this_platform

TEMPORARY_SPACE = "1 GB"
WINDOWS_LONGEST = 260 - len(
    f"C:\\Users\\{'u' * 20}\\AppData\\Roaming\\Blender Foundation\\Blender\\4.2\\extensions\\.local\\lib\\"
    "python3.11\\site-packages\\\0"
)
"""Characters that Windows leaves to a path inside a wheel, of a user with as long a name as it allows"""


def build(output: Path, platform: str, torch: bool = False) -> Path:
    """Build a platform's zip into the folder `output`, let Blender's tool validate it, and say what is in it.

    Raises BuildError for an unknown platform, BuildError or LandmarkModelError where a part is not to be had
    or is not the locked one, OutputError and OSError where something cannot be written.
    """
    if platform not in PLATFORMS:
        raise BuildError(f"{platform}: there is no zip for this platform; choose from {', '.join(PLATFORMS)}")
    tool = extension_tool()
    with tempfile.TemporaryDirectory() as temporary:
        wheels = [*locked_wheels(platform, torch), core_wheel(Path(temporary))]
        wheels.sort(key=lambda wheel: wheel.path.name)
        if platform.startswith("windows"):
            _refuse_long_paths(wheels)
        staged = Path(temporary) / "staged"
        staged.mkdir()
        stage(staged, platform, wheels)
        kind = "-torch" if torch else ""
        made = Path(temporary) / f"manient-{__version__}-{platform.replace('-', '_')}{kind}.zip"
        run_tool(tool, "build", "--source-dir", str(staged), "--output-filepath", str(made))
        fix(made)
        run_tool(tool, "validate", str(made))
        path = output.resolve() / made.name
        with written_whole(path) as beside:
            shutil.copyfile(made, beside)
        print(f"{path}\n\n{table(path, wheels)}\n", flush=True)
    return path


def _refuse_long_paths(wheels: Sequence[Wheel]) -> None:
    for wheel in wheels:
        longest = max(wheel.members, key=len)
        if len(longest) > WINDOWS_LONGEST:
            raise BuildError(
                f"{wheel.path.name}: Windows cannot unpack {longest} for users with long names; pin another "
                "version in constraints.txt"
            )


def table(path: Path, wheels: Sequence[Wheel]) -> str:
    """Sizes of a zip's parts, packed and unpacked, as Markdown, and the total that a Blender unpacks."""
    rows = [
        (w.name, w.version, licence(w), " ".join(w.pythons), w.size, sum(w.members.values()))
        for w in sorted(wheels, key=lambda wheel: -wheel.size)
    ]
    with zipfile.ZipFile(path) as opened:
        own = sum(i.file_size for i in opened.infolist() if not i.filename.startswith("wheels/"))
    rows += [("add-on", __version__, "GPL-3.0-or-later", " ".join(PYTHONS), own, own)]
    rows += [("total", "", "", "", path.stat().st_size, sum(row[5] for row in rows))]
    lines = ["| part | version | licence | Python | in the zip | unpacked |", "|---|---|---|---|---:|---:|"]
    lines += [f"| {' | '.join(row[:4])} | {row[4] / 1e6:.1f} MB | {row[5] / 1e6:.1f} MB |" for row in rows]
    for python in PYTHONS:
        unpacked = sum(row[5] for row in rows if python in row[3])
        lines += ["", f"With Python {python} a Blender unpacks {unpacked / 1e6:.0f} MB."]
    return "\n".join(lines)


def main() -> int:
    """Build; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the add-on's zip for Blender.")
    parser.add_argument("--platform", metavar="NAMES", default=this_platform(), help=", ".join(PLATFORMS))
    parser.add_argument(
        "--torch", choices=("none", "cpu"), default="none", help="for the paper's experiments"
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "extension", metavar="DIR")
    options = parser.parse_args()
    try:
        for platform in options.platform.split(","):
            build(options.output, platform.strip(), options.torch == "cpu")
    except HandfitError as error:
        sys.exit(f"error: {error}")
    except OSError as error:
        sys.exit(
            f"error: {error}; a build needs {TEMPORARY_SPACE} below {tempfile.gettempdir()} (TMPDIR names "
            "another folder), and folders that it may write to"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
