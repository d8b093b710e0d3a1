"""No name and no content of a file makes a decoder open something else: an address, or another file."""

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.media.opening import open_media
from handfit_core.media.size_limit import check_for_blender
from tests.bombs import clip
from tests.listener import listening
from tests.playlists import names, playlists


def test_a_name_is_no_address(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = clip(tmp_path / "clip.mp4", frames=5)
    with listening(tmp_path) as (port, connections):
        for name in [*names(port), "file:clip.mp4", "concat:clip.mp4", "subfile,,start,0,end,9,,:clip.mp4"]:
            (tmp_path / name).write_bytes(content)
            media = open_media(name)
            assert len(list(media.frames())) == 5, name
            assert media.source.files == (str(tmp_path / name),)
        assert connections() == 0


@pytest.mark.parametrize("name", ["list.mp4", "list.avi", "list.xyz", "list.gif"])
def test_a_playlist_is_no_video(tmp_path, name):
    hidden = tmp_path / "hidden.mp4"
    clip(hidden)
    with listening(tmp_path) as (port, connections):
        for address in (f"http://127.0.0.1:{port}/clip.mp4", str(hidden), hidden.name, f"file:{hidden}"):
            for kind, content in playlists(address).items():
                (tmp_path / name).write_bytes(content)
                with pytest.raises(InputError, match="this is "):
                    open_media(tmp_path / name)
                assert connections() == 0, kind


def test_a_pattern_in_a_videos_name_reads_no_pictures(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"secret{number}.png"), np.full((48, 64, 3), 99, dtype=np.uint8))
    for name in ("secret%d.mp4", "secret%01d.png.xyz", "secret%d.gif"):
        (tmp_path / name).write_bytes(clip(tmp_path / "clip.mp4", frames=5))
        assert len(list(open_media(tmp_path / name).frames())) == 5
        if name.endswith("mp4"):
            check_for_blender(tmp_path / name)  # no picture has this ending, by which FFmpeg goes
            continue
        with pytest.raises(InputError, match="rename them"):
            check_for_blender(tmp_path / name)
    # Without such a file it is meant as a pattern.
    assert open_media(tmp_path / "secret%d.png").source.kind == "sequence"
