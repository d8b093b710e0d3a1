"""Photos of phones and plates of studios, and pictures that lie far from what a screen shows."""

import io
import logging
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.media.exif import read_focal_35mm
from handfit_core.media.headers import Header, is_animated, read_picture_header
from handfit_core.media.kinds import what_is
from handfit_core.media.opening import open_media
from handfit_core.media.pictures import read_picture
from handfit_core.media.size_limit import check_for_blender
from tests.core.media.test_exif import encoded, tiff_block, with_exif
from tests.plates import box, dpx, exr, heic, tile

RED, GREEN, BLUE, WHITE = (220, 20, 20), (20, 200, 20), (20, 20, 220), (235, 235, 235)


def read(path: Path, data: bytes) -> np.ndarray:
    path.write_bytes(data)
    return read_picture(path)[0]


def corners(rgb: np.ndarray) -> list[int]:
    """The strongest channel at each corner, clockwise from the upper left; 3 for white."""
    at = (rgb[2, 2], rgb[2, -3], rgb[-3, -3], rgb[-3, 2])
    return [3 if each.min() > 150 else int(each.argmax()) for each in at]


def four(**options) -> bytes:
    """Four tiles, of which the right and lower ones reach beyond the picture."""
    return heic([tile(c) for c in (RED, GREEN, WHITE, BLUE)], (100, 90), grid=(2, 2), **options)


def test_a_phones_photo_is_joined_of_its_tiles(tmp_path):
    rgb = read(tmp_path / "a.heic", four())
    assert rgb.shape == (90, 100, 3)
    assert corners(rgb) == [0, 1, 2, 3]
    np.testing.assert_allclose(rgb[40, 40], RED, atol=6)
    assert rgb[63, 10].argmax() == 0
    assert rgb[64, 10].min() > 150
    assert read_picture_header(io.BytesIO(four())) == Header(100, 90)
    assert read_focal_35mm(four() + b"\0\0\0\6Exif\0\0" + tiff_block(1, ">", 26)) == 26.0
    single = heic([tile(RED)], (64, 64))
    np.testing.assert_allclose(read(tmp_path / "b.heic", single)[20, 20], RED, atol=6)


@pytest.mark.parametrize(
    ("boxes", "orientation", "seen"),
    [
        ([("irot", 3)], 6, [3, 0, 1, 2]),
        ([("irot", 1)], 8, [1, 2, 3, 0]),
        ([("imir", 1)], 2, [1, 0, 3, 2]),
        ([("irot", 1), ("imir", 0)], 5, [0, 3, 2, 1]),
        ([("imir", 0), ("irot", 3)], 5, [0, 3, 2, 1]),
    ],
)
def test_a_photo_is_turned_as_its_properties_say(tmp_path, boxes, orientation, seen):
    path = tmp_path / "a.heic"
    path.write_bytes(four(more=[box(name.encode(), bytes([value])) for name, value in boxes]))
    media = open_media(path)
    (frame,) = media.frames()
    assert (media.source.orientation, media.width) == (orientation, 90 if orientation > 4 else 100)
    assert frame.rgb is not None
    assert corners(frame.rgb) == seen


def test_a_photo_is_cropped_to_its_aperture(tmp_path):
    aperture = box(b"clap", struct.pack(">4I4i", 80, 1, 89, 1, 10, 1, -1, 2))
    rgb = read(tmp_path / "a.heic", four(more=[aperture]))
    assert rgb.shape == (89, 80, 3)
    assert rgb[0, 43].argmax() == 0
    assert rgb[0, 44].argmax() == 1


DAMAGED = {
    "a tile is missing": (four().replace(tile(GREEN)[1], bytes(len(tile(GREEN)[1]))), "1 of 4 tiles"),
    "another count of tiles": (heic([tile(RED)] * 3, (100, 90), grid=(2, 2)), "unusual layout"),
    "tiles that do not cover it": (heic([tile(RED)] * 4, (300, 90), grid=(2, 2)), "unusual layout"),
    "too large": (
        heic([tile(RED)] * 4, (20_000, 20_000), grid=(2, 2), tile_size=(10_000, 10_000)),
        "20000 x",
    ),
    "larger than it says": (heic([tile(RED, 512, 512)], (16, 16), tile_size=(16, 16)), "HEIC"),
    "cut off": (four()[:-900], "HEIC"),
}


@pytest.mark.parametrize(("data", "said"), DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_photo_is_a_sentence(tmp_path, data, said):
    with pytest.raises(InputError, match=said):
        read(tmp_path / "a.heic", data)


def test_a_phones_photo_is_not_for_blender(tmp_path):
    (tmp_path / "a.heic").write_bytes(four())
    with pytest.raises(InputError, match="HEIC or AVIF photo, which few Blenders read"):
        check_for_blender(tmp_path / "a.heic")


def test_avif(tmp_path):
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="avif") as container:
        stream = container.add_stream("libsvtav1", rate=1, options={"svtav1-params": "preset=12"})
        stream.width, stream.height, stream.pix_fmt = 80, 64, "yuv420p"
        pixels = np.full((64, 80, 3), RED, dtype=np.uint8)
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        for packet in (*stream.encode(frame), *stream.encode(None)):
            packet.pts = packet.dts = 0
            container.mux(packet)
    np.testing.assert_allclose(read(tmp_path / "a.avif", file.getvalue())[30, 40], RED, atol=6)


def linear(*rgb: float, kind: type = np.float32) -> np.ndarray:
    return np.full((24, 32, 3), rgb[::-1], dtype=kind)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_openexr_is_linear(tmp_path, kind):
    rgb = read(tmp_path / "a.exr", exr(linear(0.5, 0.0, 0.002, kind=kind)))
    np.testing.assert_array_equal(rgb[5, 5], [188, 0, 7])  # the curve of sRGB


def test_openexr_of_several_layers_and_windows(tmp_path):
    """The picture itself is read, and all of it that was drawn."""
    layers = [f"{layer}.{colour}" for layer in ("V.AO", "V.Combined") for colour in "BGR"]
    data = exr(np.concatenate([linear(0.9, 0.9, 0.9), linear(0.5, 0.2, 0.1)], axis=2), layers)
    np.testing.assert_array_equal(read(tmp_path / "a.exr", data)[0, 0], [188, 124, 89])
    rgb = read(tmp_path / "b.exr", exr(linear(0.5, 0.5, 0.5), shown=(0, 0, 9999, 9999)))
    assert rgb.shape == (24, 32, 3)
    with pytest.raises(InputError, match=r"without colours \(it has Z\)"):
        read(tmp_path / "c.exr", exr(linear(1, 1, 1)[..., :1], ["Z"]))


def test_nan_and_infinities_are_black_and_white(tmp_path):
    pixels = linear(0.5, 0.5, 0.5)
    pixels[0, :3] = np.array([np.nan, np.inf, -np.inf])[:, None]
    rgb = read(tmp_path / "a.exr", exr(pixels))
    np.testing.assert_array_equal(rgb[0, :4, 0], [0, 255, 0, 188])


@pytest.mark.parametrize("form", ["gbrp10be", "rgb24", "gbrp12le"])
def test_dpx_is_taken_as_it_is_shown(tmp_path, form):
    rgb = np.full((24, 32, 3), (200, 100, 30), dtype=np.uint8)
    np.testing.assert_allclose(read(tmp_path / "a.dpx", dpx(rgb, form)), rgb, atol=1)


def test_headers_of_plates():
    assert read_picture_header(io.BytesIO(exr(linear(1, 1, 1)))) == Header(32, 24, 4)
    assert read_picture_header(io.BytesIO(exr(np.ones((2, 3, 200), np.float32), ["x"] * 200))) == Header(
        3, 2, 200
    )
    assert read_picture_header(io.BytesIO(dpx(np.zeros((24, 32, 3), np.uint8)))) == Header(32, 24, 3)


def ramp(most: int) -> np.ndarray:
    """(64, 256, 3) uint16 grey from 0 to `most`."""
    row = np.linspace(0, most, 256).astype(np.uint16)
    return np.broadcast_to(row[None, :, None], (64, 256, 3)).copy()


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_pictures_that_use_few_of_16_bits(tmp_path, caplog, bits):
    pixels = ramp(2**bits - 1)
    pixels[0, 0] = 65535  # a hot pixel
    rgb = read(tmp_path / "a.png", cv2.imencode(".png", pixels)[1].tobytes())
    np.testing.assert_allclose(rgb[1, :, 0], np.arange(256), atol=1)
    assert f"uses {bits} of its 16 bits" in caplog.text


def test_an_ordinary_16_bit_picture_is_not_changed(tmp_path, caplog):
    pixels = np.random.default_rng(0).integers(0, 65536, (64, 64, 3)).astype(np.uint16)
    rgb = read(tmp_path / "a.png", cv2.imencode(".png", pixels)[1].tobytes())
    np.testing.assert_array_equal(rgb, (pixels >> 8)[..., ::-1])
    assert not caplog.text


@pytest.mark.parametrize("exposure", [0.001, 8.0, 100.0, 30_000.0])
def test_any_exposure_of_floats(tmp_path, caplog, exposure):
    pixels = (ramp(1000)[..., :3] / 1000).astype(np.float32)
    plain = read(tmp_path / "plain.exr", exr(pixels))
    assert not caplog.text
    brought = read(tmp_path / "a.exr", exr(pixels * np.float32(exposure)))
    assert np.abs(brought.astype(int) - plain).max() < 30
    assert "linear values reach" in caplog.text


def test_a_sequence_has_one_range(tmp_path, caplog):
    """A darker frame stays darker, and it is said once."""
    for number, level in ((1, 800), (2, 200)):
        cv2.imwrite(str(tmp_path / f"a{number}.png"), np.full((12, 20, 3), level, np.uint16))
    with caplog.at_level(logging.WARNING, "handfit"):
        levels = [int(frame.rgb[0, 0, 0]) for frame in open_media(tmp_path).frames() if frame.rgb is not None]
    assert levels == [199, 50]
    assert len(caplog.records) == 1


def test_several_frames_in_a_picture(tmp_path):
    still = encoded(".png")
    for name, data, animated in (
        ("a.png", still, False),
        ("b.png", still[:33] + struct.pack(">I4sII", 8, b"acTL", 2, 0) + bytes(4) + still[33:], True),
        ("c.webp", with_exif(".webp", tiff_block()), False),
        ("d.webp", b"RIFF\0\0\0\0WEBPVP8X" + struct.pack("<I", 10) + bytes(10) + b"ANIM", True),
    ):
        (tmp_path / name).write_bytes(data)
        assert is_animated(tmp_path / name) == animated


def test_what_files_are(tmp_path):
    for data, said in (
        (b"%PDF-1.7", "a PDF"),
        (b"PK\3\4abc", "packed"),
        (b"PK\3\4" + bytes(26) + b"frames.npy", "an archive of NumPy"),
        (b"<!doctype html><html>", "a web page"),
        (b"hello", "a text"),
        (b"BLENDER-v402", "a Blender file"),
        (bytes(range(256)), "unknown"),
        (encoded(".jpg")[:20], "a JPEG picture that is cut off"),
        # At a damaged one OpenCV crashes.
        (encoded(".jp2", np.zeros((48, 64, 3), np.uint8))[:-60], "a JPEG 2000 picture"),
    ):
        (tmp_path / "a.png").write_bytes(data)
        assert said in what_is(tmp_path / "a.png")
        with pytest.raises(InputError, match=f"a.png: this is .*{said}"):
            open_media(tmp_path / "a.png")
