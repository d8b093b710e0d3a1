"""What is a video, by its first bytes, and how large its frames claim to be."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest

from handfit_core.media.headers import Header, read_video_header
from tests.bombs import clip, with_sample_count
from tests.playlists import playlists


def read(data: bytes) -> Header | None:
    return read_video_header(io.BytesIO(data))


CODES = {"mp4": "mp4v", "mov": "mp4v", "avi": "MJPG", "mkv": "mp4v", "webm": "VP80", "wmv": "WMV2"}
FILES = {f"a.{suffix}": code for suffix, code in CODES.items()}


@pytest.mark.parametrize("name", FILES)
def test_size(tmp_path: Path, name: str) -> None:
    assert read(clip(tmp_path / name, FILES[name])) == Header(64, 48)


@pytest.mark.parametrize("name", FILES)
def test_frames_that_are_claimed(tmp_path: Path, name: str) -> None:
    header = read(clip(tmp_path / name, FILES[name], frames=12))
    assert header is not None
    assert header.frames == (0 if name == "a.wmv" else 12)


def test_a_claimed_length_that_is_none_refuses_nothing(tmp_path: Path) -> None:
    whole = clip(tmp_path / "a.mkv")
    at = whole.index(b"\x44\x89\x88") + 3
    for duration in (float("nan"), float("inf"), -1.0, 1e30):
        header = read(whole[:at] + struct.pack(">d", duration) + whole[at + 8 :])
        assert header == Header(64, 48)
        assert header.frames == 0


def test_a_gifs_size() -> None:
    assert read(b"GIF89a" + struct.pack("<HH", 64, 48) + bytes(20)) == Header(64, 48)
    assert read(b"GIF89a" + bytes(20)) is None  # FFmpeg would look for what else it may be


def test_streams_without_a_header(tmp_path: Path) -> None:
    sequence = b"\0\0\1\xb3" + (720 << 12 | 576).to_bytes(3, "big") + bytes(20)
    assert read(b"\0\0\1\xba" + bytes(40) + sequence) == Header(720, 576)
    assert read(sequence) == Header(720, 576)
    packet = b"G\x40\0\x10" + bytes(184)
    assert read(packet * 5) == Header()
    assert read((bytes(4) + packet) * 5) == Header()  # as cameras write it
    by_chance = b"G\x40\0\x10" + b"<mPd" + bytes(180)
    assert read(by_chance * 5) == Header()  # compressed data, in which any four bytes may stand
    theora = b"\x80theora\3\2\1" + struct.pack(">HH", 20, 15)
    assert read(b"OggS\0\2" + bytes(22) + theora) == Header(320, 240)


def test_dv_with_its_sound_in_one_stream() -> None:
    header = b"strh" + struct.pack("<I", 8) + b"iavsdvsd" + b"strf" + struct.pack("<I", 32) + bytes(32)
    listed = b"LIST" + struct.pack("<I", 4 + len(header)) + b"strl" + header
    data = b"RIFF" + struct.pack("<I", 4 + len(listed) + 12) + b"AVI " + listed + b"LIST\4\0\0\0movi"
    assert read(data) == Header()


def test_playlists_are_none() -> None:
    for address in ("http://127.0.0.1/a.ts", "/etc/hostname"):
        for kind, content in playlists(address).items():
            assert read(content) is None, kind
    for data in (b"", b"text", b"RIFF____WEBP", b"OggS\nmore", b"\x1a\x45\xdf\xa3" + b"c=IN IP4 1\n" * 9):
        assert read(data) is None


def test_more_frames_than_bytes_is_none(tmp_path: Path) -> None:
    whole = clip(tmp_path / "a.mp4")
    assert read(with_sample_count(whole, len(whole) - 1)) == Header(64, 48)
    assert read(with_sample_count(whole, len(whole) + 1)) is None
    fragment = b"trun" + struct.pack(">II", 0, 1 << 20)
    part = struct.pack(">I", len(fragment) + 4) + fragment
    for name in (b"traf", b"moof"):
        part = struct.pack(">I", len(part) + 8) + name + part
    assert read(whole + part) is None


def test_a_packed_header_is_none(tmp_path: Path) -> None:
    """It would be unpacked to whatever size it claims."""
    whole = clip(tmp_path / "a.mp4")
    at = whole.index(b"mvhd")
    assert read(whole[:at] + b"cmov" + whole[at + 4 :]) is None


def test_a_stream_of_tiny_boxes_ends(tmp_path: Path) -> None:
    assert read(struct.pack(">I4s", 8, b"free") * 200_000) is None
    assert read(b"RIFF" + bytes(4) + b"AVI " + b"JUNK\0\0\0\0" * 200_000) is None
