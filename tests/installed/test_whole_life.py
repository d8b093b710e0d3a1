"""From installing the zip to uninstalling it, in one Blender: with nothing else at hand, and no network."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.installed.sealed import MARK, ROOT, Finished, Sealed

FRAMES = (1, 40)
OPEN_HAND_VERTICES = 1810
BLENDERS_OWN = {
    "cache/thumbnails/fail/blender/",
    "cache/thumbnails/large/",
    "profile/extensions/.cache/compat.dat",
    "profile/extensions/.local/lib/python{python}/site-packages/",
    "profile/extensions/.user/user_default/",
    "profile/extensions/user_default/.blender_ext/cache/",
}
"""What stays of any extension that was installed: Blender's list of extensions that fit, and empty folders"""
BPY_VARIABLES = {"MATERIALX_SEARCH_PATH", "PXR_MTLX_STDLIB_SEARCH_PATHS", "OCIO"}
"""What importing bpy sets by itself"""


@dataclass(frozen=True)
class Life:
    """The machine, and what the script there wrote down."""

    sealed: Sealed
    finished: Finished
    left: list[str]
    processes: list[str]

    def __getitem__(self, stage: str) -> dict:
        found = self.finished.facts.get(stage)
        assert found is not None, f"it did not get as far as {stage!r}:\n{self.finished.said[-4000:]}"
        return found


@pytest.fixture(scope="module")
def life(sealed: Sealed, zipped: Path, samples: Path) -> Life:
    finished = sealed.run(
        "whole_life",
        zip=sealed.give(zipped),
        photo=sealed.give(samples / "photos" / "thumb_up.jpg"),
        video=sealed.give(samples / "videos" / "asl_hand.mp4"),
        frames=FRAMES,
    )
    return Life(sealed, finished, sealed.left(), sealed.processes())


def test_nothing_but_the_zip_is_in_reach(life):
    found = life["surroundings"]
    assert found["interfaces"] == ["lo"]
    assert found["outside"] == "OSError"
    assert found["modules"] == []
    names = set(found["variables"])
    assert {n for n in names if n.startswith(("PYTHON", "HANDFIT_"))} == set()
    assert names <= {*life.sealed.environment, *BPY_VARIABLES}
    assert Path(found["folder"]) == life.sealed.base / "work"
    environment = Path(found["executable"]).parents[1]
    paths = [Path(p) for p in found["path"] if not Path(p).is_relative_to(environment)]
    assert not [p for p in paths if p.is_relative_to(ROOT)]


def test_it_installs_and_its_panels_are_there(life):
    assert life["installed"] == {"said": "FINISHED", "enabled": ["bl_ext.user_default.manient"]}
    assert any(text.startswith("[Source] Choose a photo") for text in life["panels"]["said"])
    (capture,) = (text for text in life["panels"]["said"] if text.startswith("[Capture] "))
    assert capture.startswith("[Capture] Scene becomes")
    assert capture.endswith(" Capture")


def test_check_installation_finds_all_well(life):
    report = life["check"]["report"]
    assert "Everything works." in report
    assert "FAILED" not in report


def test_photo(life):
    assert life["photo"]["said"] == "FINISHED"
    (hand,) = life["photo"]["hands"]
    assert (hand["side"], hand["frames"], hand["detected"]) == ("left", [1], 1)
    assert 0.5 < hand["error"] < 15.0  # pixels, in a picture of 640
    assert (hand["vertices"], hand["bones"], hand["keys"]) == (OPEN_HAND_VERTICES, 16, [1.0])
    assert hand["pictures"] == [{"name": "thumb_up.jpg", "size": [640, 521]}]
    assert hand["size"] == hand["scene"]["size"] == [640, 521]
    assert hand["scene"]["camera"]


def test_video(life):
    assert life["video"]["said"] == "FINISHED"
    (hand,) = life["video"]["hands"]
    first, last = FRAMES
    frames = list(range(first, last + 1))
    assert (hand["side"], hand["frames"]) == ("right", frames)
    assert hand["detected"] == len(frames)
    assert 0.5 < hand["error"] < 40.0  # pixels, of the worst frame in a picture of 620 x 1080
    assert hand["keys"] == frames
    assert (hand["scene"]["rate"], hand["scene"]["range"]) == (25.0, [first, last])
    assert hand["pictures"] == [{"name": "asl_hand.mp4", "size": [620, 1080]}]


def test_refit(life):
    assert (life["refit"]["moved"], life["refit"]["said"]) == ("FINISHED", "FINISHED")
    assert 0.002 < life["refit"]["by"] < 0.1  # metres


@pytest.mark.parametrize("kind", ["fbx", "glb"])
def test_exports_can_be_imported_again(life, kind):
    assert life["exported"][kind]["said"] == "FINISHED"
    assert life["exported"][kind]["bytes"] > 50_000
    assert b"MANO" not in (life.sealed.made / f"hand.{kind}").read_bytes()
    found = life["imported"][kind]
    assert found["said"] == "FINISHED"
    assert found["off"] < 1e-3  # metres between the bones of what was captured and of what came back
    assert found["moves"] > 5e-3
    # glTF splits vertices where UVs have seams.
    (vertices,) = found["vertices"]
    assert OPEN_HAND_VERTICES <= vertices < 1.2 * OPEN_HAND_VERTICES


def test_blender_itself_stays_light_and_loads_from_the_profile_alone(life):
    found = life["loaded"]
    assert found["heavy"] == []
    profile = life.sealed.base / "profile" / "extensions"
    assert Path(found["addon"]) == profile / "user_default" / "manient" / "__init__.py"
    assert Path(found["handfit_core"]).is_relative_to(profile / ".local")
    assert [f for f in found["from"] if not Path(f).is_relative_to(profile)] == []


def test_the_worker_has_what_blender_unpacked(life):
    worker = life["worker"]
    unpacked = life.sealed.base / "profile" / "extensions" / ".local"
    python = life["surroundings"]["executable"]
    assert worker["command"][0] == python
    assert MARK in worker["variables"]
    libraries = {name: Path(paths[0]) for name, paths in worker["libraries"].items()}
    assert set(libraries) == {"scipy", "cv2", "mediapipe", "numpy"}
    assert libraries.pop("numpy").is_relative_to(Path(python).parents[1])
    assert [str(p) for p in libraries.values() if not p.is_relative_to(unpacked)] == []


def test_what_the_worker_compiles_lies_in_a_folder_that_goes_with_the_extension(life):
    """And not beside what Blender has unpacked."""
    variables, compiled = life["worker"]["variables"], life["worker"]["compiled"]
    folder = life.sealed.base / "profile" / "extensions" / ".user" / "user_default" / "manient"
    assert Path(variables["PYTHONPYCACHEPREFIX"]).is_relative_to(folder)
    assert compiled > 100


def test_disabling_leaves_nothing(life):
    found = life["disabled"]
    assert found["said"] == "FINISHED"
    assert found["worker"] is False
    assert found["left"] == found["before"]


def test_it_can_be_enabled_again(life):
    found = life["enabled again"]
    assert found["enabling"] == "FINISHED"
    assert found["said"] == "FINISHED"
    assert [hand["side"] for hand in found["hands"]] == ["left"]


def test_uninstalling_leaves_nothing_in_blender(life):
    found = life["uninstalled"]
    assert found["said"] == "FINISHED"
    assert (found["enabled"], found["left"]) == ([], life["disabled"]["before"])
    assert found["worker"] is False


def test_uninstalling_leaves_no_file(life):
    assert life["uninstalled"]
    python = ".".join(life["surroundings"]["python"].split(".")[:2])
    left = set(life.left)
    if life["surroundings"]["blender"].startswith("4.2"):  # which had to be ended (inside/whole_life.py)
        left = {name for name in left if not re.fullmatch(r"tmp/blender_\w+/", name)}
    assert left <= {name.format(python=python) for name in BLENDERS_OWN}


def test_no_process_is_left_and_no_traceback_was_printed(life):
    assert life["uninstalled"]
    assert life.processes == []
    assert life.finished.code == 0, life.finished.said[-4000:]
    assert "Traceback" not in life.finished.said
