#!/usr/bin/env python3
"""Build the add-on's zip for Blender: Edit > Preferences > Get Extensions > Install from Disk.

    nox -s build                                         # for this machine's platform
    nox -s build -- --platform linux-x64,windows-x64,macos-arm64 --python 3.11,3.13
    nox -s build -- --torch none                         # for a Python of the user's own
    nox -s build -- --torch FOLDER                       # another build of torch, and what it needs
    python scripts/build_extension.py --blender PATH     # without a bpy wheel in this Python

The zip has the add-on, and as wheels handfit_core, with the open hand and the landmark model in it, and all
that it imports, for each Python. The wheels are those of the locks (scripts/extension/locks/), unmodified;
they are downloaded once, into the user's cache. The same input gives the same bytes.
"""

from __future__ import annotations

import argparse
import errno
import re
import shutil
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts.needed import need

need("numpy", "nox -s build")

from handfit_core.errors import HandfitError, OptionError
from handfit_core.files import written_whole
from scripts.extension import archive, locks, torch_choice, windows_paths
from scripts.extension.blender_tool import run_build, run_validate, tool_command
from scripts.extension.contents import Contents, Missing, sorted_wheels
from scripts.extension.core_wheel import core_wheel
from scripts.extension.downloads import fetched
from scripts.extension.licences import licence_name
from scripts.extension.parts import RUN_TIME
from scripts.extension.staging import MANIFEST, WHEELS, stage
from scripts.extension.table import Part, megabytes, table
from scripts.extension.targets import (
    PLATFORM_NAMES,
    PYTHONS,
    Platform,
    checked_pythons,
    platform_named,
    this_platform,
)
from scripts.extension.torch_choice import CPU, NONE
from scripts.extension.wheel_file import WheelFile

OUTPUT = ROOT / "out" / "extension"
TEMPORARY_SPACE = "1.2 GB"
BARE = "this zip was built without the packages that capture"


@dataclass(frozen=True)
class Built:
    """A zip: where it is, what is in it, and what is not."""

    path: Path
    platform: str
    pythons: tuple[str, ...]
    parts: tuple[Part, ...]
    missing: tuple[Missing, ...]
    warning: str
    """What keeps it from being installed on many machines; empty where nothing does."""


def build(
    output: Path,
    platform: str | None = None,
    pythons: Sequence[str] = PYTHONS,
    torch: str = CPU,
    blender: Path | None = None,
    lock_folder: Path = locks.FOLDER,
) -> Built:
    """Build the zip of a platform (None: this machine's) into the folder `output`, and validate it.

    `torch` is "cpu" (the locked one), "none" (nothing that captures: for a Python of the user's own), or the
    path of a wheel or of a folder of wheels; `blender` an
    executable whose extension tool is used (None: that of this Python's bpy wheel). Raises OptionError for
    an unknown platform or Python, BuildError or LandmarkModelError where a part is not to be had or is not
    the locked one, OutputError where `output` cannot be written.
    """
    target = platform_named(platform or this_platform())
    pythons = checked_pythons(tuple(pythons))
    tool = tool_command(blender)
    with tempfile.TemporaryDirectory() as temporary:
        wheels, missing, kind = _run_time_wheels(target, pythons, torch, lock_folder)
        wheels.append(core_wheel(Path(temporary)))
        manifest = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
        contents = Contents(
            identity=manifest["id"],
            version=manifest["version"],
            platform=target,
            pythons=pythons,
            torch=kind,
            wheels=sorted_wheels(wheels, target, pythons),
            missing=missing,
        )
        staged = Path(temporary) / "staged"
        staged.mkdir()
        stage(staged, contents)
        made = Path(temporary) / zip_name(contents)
        run_build(tool, staged, made)
        archive.fix(made)
        run_validate(tool, made)
        path = output.resolve() / made.name
        with written_whole(path) as beside:
            shutil.copyfile(made, beside)
        parts = _parts(contents, path)
        warning = windows_paths.warning([w for w, _ in contents.wheels]) if target.windows else ""
    return Built(path, target.name, pythons, parts, missing, warning)


def zip_name(contents: Contents) -> str:
    """As Blender names the zip of one platform, and what else sets it apart from the usual one."""
    name = f"{contents.identity}-{contents.version}-{contents.platform.name.replace('-', '_')}"
    if contents.pythons != PYTHONS:
        name += "".join(f"-py{python.replace('.', '')}" for python in contents.pythons)
    if contents.torch == NONE:
        name += "-no_torch"
    elif contents.torch != CPU:
        # Also where it is a CPU build: it is not the one of the usual zip.
        name += "-torch_" + re.sub(r"[^\w.]+", "_", contents.torch)
    return name + ".zip"


def _run_time_wheels(
    platform: Platform, pythons: Sequence[str], torch: str, lock_folder: Path
) -> tuple[list[WheelFile], tuple[Missing, ...], str]:
    """The wheels besides handfit_core, what is missing, and what wheels.json says of torch."""
    if torch == NONE:
        # Without torch nothing captures here, and a Python of one's own has the others, too.
        return [], tuple(Missing(name, python, BARE) for python in pythons for name in RUN_TIME), NONE
    own = [] if torch == CPU else torch_choice.own_torch(torch, platform, pythons)
    replaced = {wheel.name for wheel in own}
    wheels, missing = list(own), []
    for python in pythons:
        lock = locks.read_lock(locks.lock_path(platform.name, python, lock_folder))
        pins = [pin for pin in lock.pins if pin.name not in replaced]
        wheels += fetched(pins, platform, python)
        absent = {name: why for name, why in lock.missing.items() if name not in replaced}
        if own and not any(w.name == "torch" and w.fits(platform, [python]) for w in own):
            absent["torch"] = f"this zip was built with a torch that is not for Python {python}"
        missing += [Missing(name, python, why) for name, why in absent.items()]
    versions = sorted({wheel.version for wheel in own if wheel.name == "torch"})
    return wheels, tuple(missing), " ".join(versions) or torch


def _parts(contents: Contents, path: Path) -> tuple[Part, ...]:
    parts = [
        Part(w.name, w.version, w.path.name, w.size, w.unpacked_size, licence_name(w), pythons)
        for w, pythons in contents.wheels
    ]
    with zipfile.ZipFile(path) as opened:
        rest = [i for i in opened.infolist() if not i.filename.startswith(f"{WHEELS}/")]
    size, unpacked = sum(i.compress_size for i in rest), sum(i.file_size for i in rest)
    addon = Part(
        contents.identity, contents.version, None, size, unpacked, "GPL-3.0-or-later", contents.pythons
    )
    return (addon, *sorted(parts, key=lambda part: -part.size))


def report(built: Built, markdown: bool = False) -> str:
    """What `main` prints of a zip: its table, what is missing from it, and paths too long for Windows."""
    size = built.path.stat().st_size
    lines = [f"{built.path} ({megabytes(size)})", "", table(built.parts, size, markdown), ""]
    lines += [
        f"unpacked in a Blender with Python {python}: "
        + megabytes(sum(part.unpacked_size for part in built.parts if python in part.pythons))
        for python in built.pythons
    ]
    for why in dict.fromkeys(missing.why for missing in built.missing):
        same = [missing for missing in built.missing if missing.why == why]
        names, pythons = dict.fromkeys(m.name for m in same), dict.fromkeys(m.python for m in same)
        lines.append(f"missing: {', '.join(names)} for Python {' and '.join(pythons)}: {why}")
    lines += [built.warning] if built.warning else []
    return "\n".join(lines)


def listed(names: str) -> list[str]:
    """The names of a list such as "linux-x64, windows-x64", each once."""
    return list(dict.fromkeys(filter(None, (name.strip() for name in names.split(",")))))


def system_error(error: OSError) -> str:
    """One sentence for what the system refused."""
    what = str(error.strerror or error)
    if error.filename and error.errno != errno.ENOSPC:  # whose file is the one that is copied
        what = f"{error.filename}: {what}"
    return (
        f"{what}; a build needs {TEMPORARY_SPACE} below {tempfile.gettempdir()} (TMPDIR names another "
        "folder), and folders that it may write to"
    )


def main() -> int:
    """Build; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the add-on's zip for Blender.")
    parser.add_argument(
        "--platform", metavar="NAMES", default=this_platform(), help=", ".join(PLATFORM_NAMES)
    )
    parser.add_argument("--python", metavar="VERSIONS", default=",".join(PYTHONS), help="of the Blenders")
    parser.add_argument("--torch", default=CPU, help="cpu, none, or a wheel or folder of wheels")
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT, metavar="DIR")
    parser.add_argument("--blender", type=Path, metavar="PATH", help="use this Blender's extension tool")
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    options = parser.parse_args()
    try:
        platforms = [platform_named(name).name for name in listed(options.platform)]
        pythons = checked_pythons(listed(options.python))
        if not platforms:
            raise OptionError(f"no platform was named; choose from {', '.join(PLATFORM_NAMES)}")
        for platform in platforms:
            built = build(options.output, platform, pythons, options.torch, options.blender)
            print(report(built, options.markdown), end="\n\n", flush=True)
    except OSError as error:
        print(f"error: {system_error(error)}", file=sys.stderr)
        return 1
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
