"""The zip as scripts/build_extension.py makes it, with the real wheels and Blender's own tool.

That it installs and captures is in tests/installed/.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from handfit_core.detect.landmark_model import BODY, NETWORK_2020, TASK
from scripts.build_extension import build
from scripts.extension import wheels
from scripts.extension.core_wheel import LANDMARK_MODELS, NOT_THE_ARTISTS
from scripts.extension.wheels import (
    PLATFORMS,
    PYTHONS,
    TORCH,
    BuildError,
    lock_path,
    read_lock,
    this_platform,
)

ROOT = Path(__file__).resolve().parents[2]

MOST = 200_000_000
"""bytes that an artist downloads"""

pytestmark = [
    pytest.mark.slow,  # CI builds the zip and installs it anyway
    pytest.mark.skipif(this_platform() not in PLATFORMS, reason=f"there is no zip for {this_platform()}"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The usual zip of this machine's platform."""
    try:
        return build(tmp_path_factory.mktemp("extension"), this_platform())
    except BuildError as error:
        if "could not be downloaded" in str(error):
            pytest.skip(f"wheels are neither in the cache nor to be downloaded: {error}")
        raise


@pytest.fixture
def zipped(built) -> Iterator[zipfile.ZipFile]:
    with zipfile.ZipFile(built) as archive:
        yield archive


def test_contents(built, zipped):
    names = zipped.namelist()
    assert {"__init__.py", "LICENSE", "operators/capture.py", "panels/__init__.py"} <= set(names)
    assert {"THIRD_PARTY_LICENSES", "sbom.cdx.json"} <= set(names)
    assert len(names) == len(set(names))
    assert not [name for name in names if "__pycache__" in name or name.startswith("tests")]
    manifest = tomllib.loads(zipped.read("blender_manifest.toml").decode())
    source = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == source["version"]
    assert manifest["platforms"] == [this_platform()]
    inside = {name for name in names if name.startswith("wheels/")}
    assert {wheel.removeprefix("./") for wheel in manifest["wheels"]} == inside
    assert built.name == f"manient-{source['version']}-{this_platform().replace('-', '_')}.zip"
    assert built.stat().st_size <= MOST


def test_the_wheels_are_the_locked_ones_and_the_core(zipped):
    """Unmodified, since their hashes are those of the index; and without torch."""
    locked = {
        pin.sha256
        for python in PYTHONS
        for pin in read_lock(lock_path(this_platform(), python))
        if pin.name not in TORCH
    }
    files = [name for name in zipped.namelist() if name.startswith("wheels/")]
    (core,) = [name for name in files if "/handfit_core-" in name]
    assert {hashlib.sha256(zipped.read(name)).hexdigest() for name in files if name != core} == locked


def test_the_core_is_its_source_with_the_models_and_without_evaluation_and_network(zipped, tmp_path):
    (name,) = [n for n in zipped.namelist() if n.startswith("wheels/handfit_core-")]
    zipped.extract(name, tmp_path)
    with zipfile.ZipFile(tmp_path / name) as wheel:
        models = [wheel.read(name) for name in LANDMARK_MODELS]
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    sums = [hashlib.sha256(content).hexdigest() for content in models]
    assert sums == [TASK.sha256, BODY.sha256, NETWORK_2020.sha256]
    assert {name for name in names if not name.endswith(".py")} == {
        "handfit_core/py.typed",
        "handfit_core/detect/data/LICENSE-landmark-model.txt",
        "handfit_core/detect/data/body_landmarks.task",
        "handfit_core/detect/data/hand_landmarker.task",
        "handfit_core/detect/data/hand_landmarks_2020.tflite",
        "handfit_core/hand_model/data/LICENSE-open-hand.md",
        "handfit_core/hand_model/data/landmarks.npz",
        "handfit_core/hand_model/data/open_hand_left.npz",
        "handfit_core/hand_model/data/open_hand_right.npz",
        "handfit_core/hand_model/data/poses.npz",
        "handfit_core/detect/correction/data/landmark_network.npz",
        "handfit_core/fit/data/doubt.npz",
        "handfit_core/interchange/data/lift_network.npz",
    }
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "handfit_core").rglob("*.py")}
    artists = {name for name in modules if not name.startswith(NOT_THE_ARTISTS)}
    assert {name for name in names if name.endswith(".py")} == artists


def test_every_licence_file_of_the_wheels_stands_in_the_list(zipped, tmp_path):
    """SciPy and OpenCV have some outside of their metadata."""
    text = zipped.read("THIRD_PARTY_LICENSES").decode()
    names = {"license", "licence", "copying", "notice"}
    beside_code = 0
    for file in [n for n in zipped.namelist() if n.startswith("wheels/") and "handfit_core" not in n]:
        with zipfile.ZipFile(zipped.extract(file, tmp_path)) as wheel:
            for name in wheel.namelist():
                first = re.split(r"[^a-z]", name.rpartition("/")[2].lower())[0]
                if first in names and not name.endswith((".py", "/")):
                    assert f"--- {name} ---" in text, file
                    assert wheel.read(name).decode(errors="replace").strip() in text, name
                    beside_code += "/scipy-" in file and ".dist-info/" not in name
    assert beside_code == 4 * len(PYTHONS)


def test_same_input_same_bytes(built, zipped, tmp_path):
    """At another time, in another folder, with another umask and time zone."""
    script = ROOT / "scripts" / "build_extension.py"
    subprocess.run(
        [sys.executable, str(script), "-o", str(tmp_path)],
        check=True,
        capture_output=True,
        env={**os.environ, "TZ": "Asia/Tokyo"},
        umask=0o077,
    )
    again = tmp_path / built.name
    assert wheels.sha256_of(again) == wheels.sha256_of(built)


def test_a_wrong_hash_in_a_lock_is_refused(tmp_path, monkeypatch):
    """Although the right wheel is in the cache."""
    lock = lock_path("linux-x64", "3.11")
    spoiled = re.sub(r"(mediapipe.*sha256:)\w+", rf"\g<1>{'0' * 64}", lock.read_text(encoding="utf-8"))
    (tmp_path / lock.name).write_text(spoiled, encoding="utf-8")
    monkeypatch.setattr(wheels, "LOCKS", tmp_path)
    with pytest.raises(BuildError, match=r"linux-x64, Python 3\.11 could not be downloaded"):
        build(tmp_path, "linux-x64")
    assert not list(tmp_path.glob("*.zip"))


def test_an_unknown_platform_is_one_sentence(tmp_path):
    script = ROOT / "scripts" / "build_extension.py"
    command = [sys.executable, str(script), "--platform", "amiga", "-o", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    said = "error: amiga: there is no zip for this platform; choose from linux-x64"
    assert done.stderr.startswith(said)
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
