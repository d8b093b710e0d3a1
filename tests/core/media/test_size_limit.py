"""What claims more than may be read is refused in a sentence, before it costs memory."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.media.size_limit import (
    PICTURE,
    SMALL_FILE,
    VIDEO,
    Limit,
    check_for_blender,
    check_picture,
    check_video,
    common_limit,
)
from tests.bombs import clip, with_claimed_size, with_frame_count
from tests.child import peak_megabytes

SUFFIXES = ".jpg .png .webp .bmp .tif .ppm .pgm .hdr".split()


def jpeg(path: Path, width: int, height: int, size: int = 0) -> Path:
    """A file of at least `size` bytes."""
    data = with_claimed_size(".jpg", width, height)
    path.write_bytes(data + bytes(max(0, size - len(data))))
    return path


REFUSED = """
    import sys
    from handfit_core.common.errors import InputError
    from handfit_core.media.opening import open_media
    for name in sys.argv[2:]:
        try:
            open_media(name)
        except InputError as error:
            assert sys.argv[1] in str(error), error
        else:
            raise AssertionError(name)
    """


def test_no_small_picture_takes_the_memory_that_it_claims(tmp_path):
    files = [tmp_path / f"a{suffix}" for suffix in SUFFIXES]
    for file in files:
        file.write_bytes(with_claimed_size(file.suffix, 16000, 15000))
    assert peak_megabytes(REFUSED, "claims 16000 x 15000 pixels (240 megapixels", *files) < 200


def deep_png(path: Path, width: int, height: int, size: int = 0) -> Path:
    """One with 16 bits per channel, of at least `size` bytes."""
    data = bytearray(with_claimed_size(".png", width, height))
    data[24] = 16
    path.write_bytes(data)
    os.truncate(path, max(size, len(data)))
    return path


MANY = Limit(PICTURE.large_file, PICTURE.large_file)
"""Of each of many pictures that are large together"""


@pytest.mark.parametrize(
    ("make", "width", "height", "size", "limit", "said"),
    [
        (jpeg, 8000, 8000, 0, None, ""),
        (jpeg, 8001, 8000, 0, None, "in a file under 10 MB no more than 64 are read; .* allow more"),
        (jpeg, 8001, 8000, 0, 251, ""),
        (jpeg, 25_000, 10_000, SMALL_FILE, None, ""),  # a medium-format camera's
        (jpeg, 25_000, 10_001, SMALL_FILE, None, "no more than 250 are read"),
        (jpeg, 25_000, 10_001, SMALL_FILE, 251, ""),
        (deep_png, 65_536, 1, 0, 251, "claims 65536 x 1 pixels, and no side of more than 65535 is read"),
        (deep_png, 10_000, 10_000, 0, None, r"count as 300\), and in a file under 10 MB no more than 64"),
        # Fewer bytes than pixels
        (deep_png, 10_000, 10_000, SMALL_FILE, None, r"count as 300\), and no more than 250"),
        (deep_png, 10_000, 10_000, 10**8, None, ""),
        (deep_png, 10_000, 10_000, 10**8, 99, r"\(100 megapixels\), and no more than 99 are read"),
        (deep_png, 9000, 9000, SMALL_FILE // 2, MANY, ""),
        # 250 megapixels of 16 bits would take four gigabytes.
        (deep_png, 25_000, 10_000, 0, MANY, r"count as 750\), and in a file .* no more than 250 are read"),
    ],
)
def test_limits(tmp_path, make, width, height, size, limit, said):
    path = make(tmp_path / "a", width, height, size)
    if not said:
        check_picture(path, limit)
        return
    with pytest.raises(InputError, match=said):
        check_picture(path, limit)


def test_one_limit_for_all_pictures_of_an_input(tmp_path):
    large = [deep_png(tmp_path / f"{i}.png", 10, 10, SMALL_FILE // 2) for i in range(2)]
    assert common_limit(large, None) == MANY
    assert common_limit(large, 12.5) == 12.5
    assert common_limit(large[:1], None) is None
    assert common_limit([large[0], jpeg(tmp_path / "b.jpg", 9, 9), tmp_path / "gone.jpg"], None) is None


def test_a_frame_with_few_bytes_is_read_as_its_neighbours_are(tmp_path):
    flat = np.zeros((8100, 8000, 3), dtype=np.uint8)  # more than small files may claim
    for number in (1, 2):
        cv2.imwrite(str(tmp_path / f"a{number}.png"), flat)
    padded = tmp_path / "a2.png"
    padded.write_bytes(padded.read_bytes() + bytes(SMALL_FILE))
    assert [frame.rgb is not None for frame in open_media(tmp_path).frames()] == [True, True]


def test_the_limit_is_an_option(tmp_path):
    for name in ("a1.png", "a2.png"):
        cv2.imwrite(str(tmp_path / name), np.full((1000, 1200, 3), 90, dtype=np.uint8))
    for source in (tmp_path, tmp_path / "a1.png", str(tmp_path / "a%d.png")):
        assert open_media(source, max_megapixels=1.3).width == 1200
        with pytest.raises(InputError, match="1200 x 1000 pixels"):
            open_media(source, max_megapixels=1.1)


def test_videos_have_limits_of_their_own(tmp_path):
    clip(tmp_path / "a.mp4")
    check_video(tmp_path / "a.mp4", None, (4096, 2160))
    with pytest.raises(InputError, match=f"no more than {VIDEO.small_file:g} are read"):
        check_video(tmp_path / "a.mp4", None, (7680, 4320))
    with pytest.raises(InputError, match="64 x 48 pixels"):
        open_media(tmp_path / "a.mp4", max_megapixels=0.003)


def test_a_stream_that_is_larger_than_its_container_says(tmp_path):
    """Its first frame is not decoded: the decoder tells its size before."""
    path = tmp_path / "large.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (4800, 3200))
    for _ in range(3):
        writer.write(np.zeros((3200, 4800, 3), dtype=np.uint8))
    writer.release()
    data = path.read_bytes()
    for wide, high in ((b"\x12\xc0", b"\x0c\x80"), (b"\x12\xc0\0\0", b"\x0c\x80\0\0")):
        assert wide + high in data
        data = data.replace(
            wide + high, b"\0\x40".ljust(len(wide), b"\0") + b"\0\x30".ljust(len(high), b"\0")
        )
    path.write_bytes(data)
    assert peak_megabytes(REFUSED, "4800 x 3200 pixels", path) < 150


def test_frames_are_counted_and_not_listed(tmp_path):
    (tmp_path / "a.mp4").write_bytes(with_frame_count(clip(tmp_path / "a.mp4"), (1 << 31) - 1))
    code = """
        import sys
        from handfit_core.media.frame_range import FrameRange
        from handfit_core.media.opening import open_media
        for text, count in (("1-", 10), ("0-2000000000", 10), ("3-9999999999:2", 4), ("5-", 6)):
            media = open_media(sys.argv[1], FrameRange.parse(text))
            assert len(list(media.frames())) == count
        """
    assert peak_megabytes(code, tmp_path / "a.mp4", limit=1 << 31) < 200
    media = open_media(tmp_path / "a.mp4")
    assert (media.expected_frames, media.first_and_last) == (10, (1, 10))
    for name in ("shot.0000000001.png", "shot.9999999999.png"):
        cv2.imwrite(str(tmp_path / name), np.zeros((12, 20, 3), dtype=np.uint8))
    media = open_media(str(tmp_path / "shot.%010d.png"), FrameRange.parse("0-2000000000"))
    assert [frame.number for frame in media.frames()] == [1, 2]  # far apart: no frames to go through


def test_what_blender_is_given(tmp_path):
    check_for_blender(jpeg(tmp_path / "a.jpg", 800, 600))
    clip(tmp_path / "a.mp4")
    check_for_blender(tmp_path / "a.mp4")
    (tmp_path / "a.mp4").rename(tmp_path / "a.jpg")
    check_for_blender(tmp_path / "a.jpg")  # its content counts, as it does for Blender
    (tmp_path / "b.jpg").write_text("#EXTM3U\nhttp://127.0.0.1/a.ts\n")
    for path in (jpeg(tmp_path / "c.mp4", 32000, 32000), tmp_path / "b.jpg", tmp_path / "gone.jpg", tmp_path):
        with pytest.raises(InputError):
            check_for_blender(path)
