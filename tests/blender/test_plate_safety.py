"""A take may name any file: what Blender is given as the picture behind the hands is looked at first."""

from __future__ import annotations

import os
import sys
from types import SimpleNamespace

import bpy
import cv2
import numpy as np
import pytest

from blender_manient.scene.build import build_take
from blender_manient.session import source_info
from handfit_core.media.source import Source
from tests.bombs import clip, with_claimed_size
from tests.child import peak_megabytes
from tests.listener import listening
from tests.playlists import names, playlists

from .conftest import HEIGHT, WIDTH


def test_a_name_is_no_address(make_take, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = clip(tmp_path / "clip.mp4")
    with listening(tmp_path) as (port, connections):
        for name in names(port):
            (tmp_path / name).write_bytes(content)
            for kind in ("video", "photo"):
                built = build_take(make_take(source=Source(kind, (name,)), width=64, height=48).take)
                image = built.camera.data.background_images[0].image
                assert image.filepath == str(tmp_path / name)
                assert tuple(image.size) == (64, 48)
            assert source_info.resolve(name, as_sequence=False).files == (str(tmp_path / name),)
        assert connections() == 0


@pytest.mark.parametrize("kind", ["video", "photo", "sequence"])
def test_a_playlist_is_no_picture(make_take, tmp_path, kind):
    path = tmp_path / "list.0001.mp4"
    with listening(tmp_path) as (port, connections):
        for content in playlists(f"http://127.0.0.1:{port}/clip.mp4").values():
            path.write_bytes(content)
            built = build_take(make_take(source=Source(kind, (str(path),))).take)
            assert len(built.warnings) == 1
            assert "cannot read" in built.warnings[0]
            assert not built.camera.data.background_images
        assert connections() == 0
    assert not bpy.data.images


def test_a_picture_that_claims_too_much_is_not_loaded(make_take, tmp_path):
    path = tmp_path / "large.jpg"
    path.write_bytes(with_claimed_size(".jpg", 32000, 32000))
    take = make_take(source=Source("photo", (str(path),))).take
    built = build_take(take)
    assert "claims 32000 x 32000 pixels (1024 megapixels)" in built.warnings[0]
    assert not bpy.data.images
    path.write_bytes(cv2.imencode(".jpg", np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))[1].tobytes())
    assert build_take(take, max_megapixels=1.0).warnings == ()
    assert "no more than 0.01 are read" in build_take(take, max_megapixels=0.01).warnings[0]


def test_every_picture_that_blender_would_show_is_looked_at(make_take, tmp_path):
    """Also those between the captured ones, which no take names."""
    for number in range(1, 6):
        cv2.imwrite(str(tmp_path / f"shot.{number:04}.png"), np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))
    numbers = np.array([1, 2, 4])
    files = tuple(str(tmp_path / f"shot.{n:04}.png") for n in numbers)
    take = make_take(source=Source("sequence", files), frame_numbers=numbers).take
    assert build_take(take).warnings == ()
    (tmp_path / "shot.0005.png").write_bytes(with_claimed_size(".png", 16000, 15000))
    assert build_take(take).warnings == ()  # behind the last
    (tmp_path / "shot.0003.png").write_bytes(with_claimed_size(".png", 16000, 15000))
    assert "shot.0003.png: claims 16000 x 15000" in build_take(take).warnings[0]


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
def test_a_pipe_among_the_pictures_is_not_opened(make_take, tmp_path):
    cv2.imwrite(str(tmp_path / "shot.0001.png"), np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))
    os.mkfifo(tmp_path / "shot.0002.png")
    files = tuple(str(tmp_path / f"shot.{n:04}.png") for n in (1, 2))
    take = make_take(source=Source("sequence", files), frame_numbers=np.array([1, 2])).take
    assert "there is no such file" in build_take(take).warnings[0]


def test_no_thumbnail_of_what_may_not_be_read(tmp_path):
    good, large, listed = tmp_path / "good.png", tmp_path / "large.png", tmp_path / "list.mp4"
    good.write_bytes(with_claimed_size(".png", 80, 48))
    large.write_bytes(with_claimed_size(".png", 16000, 15000))
    listed.write_bytes(playlists("http://127.0.0.1/a.ts")["hls"])
    for path in (good, large, listed):
        settings = SimpleNamespace(source=str(path), as_sequence=False)
        assert source_info.of(settings).can_be_shown == (path == good)


def test_a_dropped_playlist_reads_no_other_file(tmp_path):
    clip(tmp_path / "hidden.mp4")
    listed, settings = tmp_path / "list.mp4", SimpleNamespace(camera="SOLVE")
    for content in playlists(str(tmp_path / "hidden.mp4")).values():
        listed.write_bytes(content)
        assert source_info.dropped_footage(settings, listed) is None
    assert source_info.dropped_footage(settings, tmp_path / "hidden.mp4") is not None


@pytest.mark.parametrize(("name", "side", "kind"), [("a.jpg", 7900, np.uint8), ("a.png", 4600, np.uint16)])
def test_a_large_turned_photo_stays_below_a_gigabyte(make_take, tmp_path, name, side, kind):
    path, saved = tmp_path / name, tmp_path / "a.npz"
    path.write_bytes(cv2.imencode(path.suffix, np.zeros((side, side, 3), dtype=kind))[1].tobytes())
    make_take(source=Source("photo", (str(path),), 6), width=side, height=side).take.save(saved)
    code = """
        import sys
        import bpy
        from blender_manient.scene.build import build_take
        from handfit_core.take import Take
        built = build_take(Take.load(sys.argv[1]))
        assert built.warnings == (), built.warnings
        width, height = built.camera.data.background_images[0].image.size
        assert 15.9e6 < width * height <= 16e6, (width, height)
        """
    assert peak_megabytes(code, saved, limit=64 << 30) < 1000
