"""Videos: damaged ones, atoms that lie, and playlists that would read other files or connect."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from tests.hostile.engine import Case, Place, file_case, table
from tests.hostile.mutations import EXTREMES, mutants

DOOR = "core.media"
PLATE = "blender.import_of"
CODECS = {"mp4": "mp4v", "avi": "MJPG", "mkv": "mp4v", "mov": "mp4v", "webm": "mp4v"}


@cache
def good_bytes(suffix: str = "mp4") -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"a.{'mkv' if suffix == 'webm' else suffix}"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*CODECS[suffix]), 12.0, (64, 48))
        for shade in range(6):
            writer.write(np.full((48, 64, 3), 40 * shade, np.uint8))
        writer.release()
        return path.read_bytes()


FIELDS = {
    "mvhd-timescale": (b"mvhd", 12), "mvhd-duration": (b"mvhd", 16), "mdhd-timescale": (b"mdhd", 12),
    "mdhd-duration": (b"mdhd", 16), "tkhd-width": (b"tkhd", 76), "stsd-size": (b"mp4v", 24), "stsd-count": (b"stsd", 4),
    "stts-entries": (b"stts", 4), "stts-frames": (b"stts", 8), "stts-length": (b"stts", 12),
    "stsc-entries": (b"stsc", 4), "stsc-samples": (b"stsc", 12), "stsz-size": (b"stsz", 4),
    "stsz-frames": (b"stsz", 8), "stco-entries": (b"stco", 4), "stco-first": (b"stco", 8), "elst": (b"elst", 8),
    "elst-time": (b"elst", 12), "tkhd-matrix-a": (b"tkhd", 40), "tkhd-matrix-b": (b"tkhd", 44),
    "mdat-size": (b"mdat", -4), "moov-size": (b"moov", -4), "trak-size": (b"trak", -4), "moov-name": (b"moov", 0),
}  # fmt: skip
"""Fields of four bytes in an mp4: atom, and how far behind its name."""


def with_field(data: bytes, atom: bytes, offset: int, value: int, every: bool = False) -> bytes:
    changed, at = bytearray(data), data.find(atom)
    while at >= 0:
        struct.pack_into(">I", changed, at + (offset if offset <= 0 else offset + 4), value)
        at = data.find(atom, at + 4) if every else -1
    return bytes(changed)


def _claims_frames(count: int) -> bytes:
    """As many frames as one likes, all of one size: the header alone says so."""
    data = good_bytes()
    for atom, offset in ((b"stts", 8), (b"stsz", 8)):
        data = with_field(data, atom, offset, count)
    return with_field(with_field(data, b"stsz", 4, 1), b"stsc", 12, count)


def _avi(*fields: tuple[bytes, int, int]) -> bytes:
    """An AVI with other values of four bytes: behind a name, at an offset."""
    data = bytearray(good_bytes("avi"))
    for name, offset, value in fields:
        struct.pack_into("<I", data, data.index(name) + offset, value)
    return bytes(data)


def _slim(width: int, height: int, both: bool) -> bytes:
    """An AVI whose stream, and perhaps its header, tells of another size."""
    header = ((b"avih", 40, width), (b"avih", 44, height)) if both else ()
    return _avi((b"strf", 12, width), (b"strf", 16, height), *header)


HLS = b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n%s\n#EXT-X-ENDLIST\n"
PLAYLISTS: dict[str, Callable[[bytes], bytes]] = {
    "hls": lambda uri: HLS % uri,
    "hls-map": lambda uri: HLS.replace(b"#EXTINF", b'#EXT-X-MAP:URI="%s"\n#EXTINF') % (uri, uri),
    "hls-key": lambda uri: HLS.replace(b"#EXTINF", b'#EXT-X-KEY:METHOD=AES-128,URI="%s"\n#EXTINF') % (uri, uri),
    "hls-master": lambda uri: b"#EXTM3U\n#EXT-X-STREAM-INF:BANDWIDTH=1\n%s\n" % uri,
    "hls-bom": lambda uri: b"\xef\xbb\xbf" + HLS % uri,
    "concat": lambda uri: b"ffconcat version 1.0\nfile '%s'\n" % uri,
    "dash": lambda uri: b'<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static" '
    b'profiles="urn:mpeg:dash:profile:isoff-on-demand:2011"><Period><AdaptationSet><Representation id="1" bandwidth="1">'
    b"<BaseURL>%s</BaseURL></Representation></AdaptationSet></Period></MPD>" % uri,
    "sdp": lambda uri: b"v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n%s\n" % uri,
    "rtsp": lambda uri: b"rtsptextRTSP:// %s\n" % uri,
    "asx": lambda uri: b'<asx version="3.0"><entry><ref href="%s"/></entry></asx>' % uri,
    "smooth": lambda uri: b"#EXTM3U8\n[playlist]\nFile1=%s\n" % uri,
    "svg": lambda uri: b'<svg xmlns="http://www.w3.org/2000/svg"><image href="%s"/></svg>' % uri,
    "mov-reference": lambda uri: _atom(b"moov", _atom(b"rmra", _atom(b"rmda", _atom(b"rdrf", bytes(4) + b"url " + struct.pack(">I", len(uri)) + uri)))),
}  # fmt: skip


TARGETS = ("other.mp4", "http://127.0.0.1:{port}/x.ts", "file:other.mp4", "tcp://127.0.0.1:{port}")


def _atom(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data) + 8) + name + data


def _playlist(build: Callable[[bytes], bytes], target: str, place: Place) -> bytes:
    place.write("other.mp4", good_bytes())
    return build(target.format(port=place.port).encode())


def cases() -> Iterator[Case]:
    for suffix in CODECS:
        good = partial(good_bytes, suffix)
        yield from mutants(suffix, DOOR, good, f"clip.{suffix}", 5)
        yield from mutants(f"footage-{suffix}", PLATE, good, f"clip.{suffix}", 1, kind="video")
    values = sorted({value & 0xFFFFFFFF for value in EXTREMES if value in (0, 1) or value > 0x7FFF})
    fields = {
        f"{field}-{value:x}": partial(
            lambda a, o, v: with_field(good_bytes(), a, o, v, True), atom, offset, value
        )
        for field, (atom, offset) in FIELDS.items()
        for value in values
    }
    yield from table("mp4", DOOR, "clip.mp4", fields)
    frames = {f"{count}-frames": partial(_claims_frames, count) for count in (10**6, 10**8, 2**31 - 1)}
    yield from table("video-mp4-claims", DOOR, "clip.mp4", frames, known=frames)
    headers = {
        f"{offset}-{value:x}": partial(_avi, (b"avih", 8 + offset, value))
        for offset in (0, 4, 16, 24, 28, 32, 36)
        for value in (0, 65535, 2**31 - 1, 2**32 - 1)
    }
    yield from table("video-avi", DOOR, "clip.avi", headers)
    slims = {
        f"{width}x{height}-{'both' if both else 'one'}": partial(_slim, width, height, both)
        for width, height in ((5000, 1), (1, 5000), (65535, 2), (100_000, 1), (1, 100_000))
        for both in (True, False)
    }
    known = ("5000x1-both", "5000x1-one")
    yield from table("slim-avi", "core.capture", "clip.avi", slims, refused=True, known=known)
    for kind, build in PLAYLISTS.items():
        followed = "hls" in kind or kind == "concat"
        for suffix in ("mp4", "gif", "mkv", "m3u8") if followed else ("mp4",):
            for target in TARGETS:
                name = f"list-{kind}-{target.partition(':')[0].replace('.', '-')}-{suffix}"
                known, data = (
                    name in ("list-hls-other-mp4-mp4", "list-hls-http-mp4"),
                    partial(_playlist, build, target),
                )
                yield file_case(name, DOOR, f"list.{suffix}", data, refused=True, known=known)
                if followed:
                    yield file_case(f"footage-{name}", PLATE, f"list.{suffix}", data, kind="video")
