"""Live runs: what is read, followed, sent and recorded, and what ends them."""

from __future__ import annotations

import contextlib
import itertools
import queue
import resource
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core import capture, live
from handfit_core.capturing.live.streaming import (
    LIVE,
    HandFilter,
    HandFollower,
    Live,
    LiveOptions,
    LivePose,
    OneEuro,
)
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.arrays import unpack
from handfit_core.common.errors import HandfitError, InputError, OptionError, OutputError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import rotmat_to_quat, rotvec_to_rotmat
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.media import camera
from handfit_core.media.camera import LiveReader, LiveSource, cameras
from handfit_core.media.opening import open_media
from handfit_core.media.recording import ClipWriter
from handfit_core.media.source import Frame
from handfit_core.take import Take
from handfit_core.worker.client import Worker
from scripts.measure_live import pictures, stamp_of, stamped
from tests.conftest import ROOT
from tests.waiting import pid_of, stopping, wait_for

PATTERN = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")
CLIP = f"file:{PATTERN}"
PATIENCE = 120.0
"""seconds until silence is a failure, on busy machines"""


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """The 24 pictures of a rendered left or right hand, 24 a second."""
    return list(open_media(PATTERN).frames())


@pytest.fixture(scope="module")
def take():
    return capture(PATTERN)


def followed(frames: list[Frame], options: LiveOptions | None = None) -> list[LivePose]:
    with HandFollower(options or LiveOptions()) as follower:
        return [follower.follow(frame) for frame in frames]


def waited(until: Any) -> None:
    """Wait until it is true."""
    end = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < end
        time.sleep(0.01)


# Filters


def test_filter_stills_what_trembles_and_follows_what_moves():
    rng = np.random.default_rng(2)
    filtering, still = HandFilter(1.0, 1.0), []
    for i in range(90):
        turns = rotvec_to_rotmat(0.02 * rng.normal(size=(16, 3)))
        still.append(filtering.step(i / 30, turns, np.array([0.0, 0.0, 0.5]) + 0.002 * rng.normal(size=3)))
    turns, places = (np.array(each[30:]) for each in zip(*still, strict=True))
    assert np.linalg.norm(turns - np.eye(3), axis=(-2, -1)).mean() < 0.6 * 0.02 * np.sqrt(6.0)
    assert places.std(axis=0).max() < 0.6 * 0.002
    moved = rotvec_to_rotmat(np.full((16, 3), 0.8))
    for i in range(90, 120):
        turns, place = filtering.step(i / 30, moved, np.array([0.1, 0.0, 0.4]))
    np.testing.assert_allclose(turns, moved, atol=0.02)
    np.testing.assert_allclose(place, [0.1, 0.0, 0.4], atol=0.002)


# Hands


def test_preview_is_near_the_full_capture(frames, take):
    (hand,) = take.hands
    model = load_model(None, hand.side)
    apart = []
    for pose in followed(frames)[4:]:
        (seen,) = pose.hands
        assert (seen.side, seen.state) == (hand.side, "seen")
        posed = model.keypoints(
            seen.betas, *(p[None] for p in (seen.global_orient, seen.hand_pose, seen.transl))
        )
        whole = hand.joints_3d[pose.sequence - 1]
        laid = align(posed[0], whole, with_scale=True).apply(posed[0])
        apart.append(np.linalg.norm(laid - whole, axis=1).mean())
    assert np.mean(apart) < 0.006


def test_measured_lens_is_that_of_the_capture(frames):
    """The hand lies where the recording's capture will put it, and is drawn where the picture shows it."""
    lens = Lens(Intrinsics(400.0, 400.0, 330.0, 235.0), (-0.3, 0.1, 0.0, 0.0, 0.0), 640, 480)
    whole = capture(PATTERN, lens=lens).hands[0]
    plain = followed(frames)
    for pose, other in list(
        zip(followed(frames, LiveOptions(CaptureOptions(lens=lens))), plain, strict=True)
    )[8:]:
        (hand,), true = pose.hands, whole.transl[pose.sequence - 1]
        assert np.linalg.norm(hand.transl - true) < 0.12 * np.linalg.norm(true)
        assert pose.intrinsics == lens.intrinsics
        np.testing.assert_allclose(hand.keypoints, other.hands[0].keypoints, atol=1e-6)


def test_lens_of_another_shape_is_one_sentence(frames):
    lens = Lens(Intrinsics(400.0, 400.0, 330.0, 235.0), (0.0,) * 5, 640, 360)
    with pytest.raises(OptionError, match="640x360"):
        followed(frames[:1], LiveOptions(CaptureOptions(lens=lens)))


def test_lost_hand_is_held_then_rests(frames):
    grey = np.full_like(frames[0].rgb, 128)
    last = frames[-1].time
    gone = [Frame(100 + i, last + 0.12 * (i + 1), grey) for i in range(14)]
    poses = [pose.hands[0] for pose in followed([*frames, *gone])[len(frames) - 1 :]]
    held = int(LIVE.hold_seconds / 0.12)
    assert [each.state for each in poses] == ["seen", *["held"] * held, *["resting"] * (14 - held)]
    np.testing.assert_array_equal(poses[held].hand_pose, poses[0].hand_pose)
    ways = [np.abs(each.hand_pose - poses[-1].hand_pose).max() for each in poses[held:]]
    assert ways[0] > 0.1
    assert ways[-2] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(ways) <= 1e-9)
    np.testing.assert_array_equal(poses[-1].transl, poses[0].transl)
    again = [replace(frame, number=200 + frame.number, time=70.0 + frame.time) for frame in frames[:6]]
    assert followed([*frames, *gone, *again])[-1].hands[0].state == "seen"


@pytest.mark.parametrize(("row", "rate", "is_open"), [(0, 30, True), (14, 30, False)])
def test_open_hand_calibrates(frames, take, row, rate, is_open):
    """It has a hand's length, and its own pose is the one at rest; a fist tells nothing."""
    grey = np.full_like(frames[0].rgb, 128)
    pictures = [frames[row].rgb] * 34 + [grey] * 40
    with HandFollower(LiveOptions()) as follower:
        follower.calibrate()
        poses = [follower.follow(Frame(i + 1, i / rate, rgb)) for i, rgb in enumerate(pictures)]
        (found,) = follower.calibrations
    assert len(found) == is_open
    for calibration in found:
        assert calibration.side == take.hands[0].side
        assert 0.16 < calibration.hand_length < 0.21  # that of the picture is 0.187 m
        np.testing.assert_allclose(poses[-1].hands[0].hand_pose, calibration.hand_pose, atol=1e-6)
        np.testing.assert_array_equal(poses[-1].hands[0].betas, calibration.betas)


@pytest.mark.parametrize(
    ("step", "gap", "quality"), [(1, 0.1, "standard"), (2, 0.02, "standard"), (2, 0.07, "draft")]
)
def test_detection_hurries_where_frames_are_dropped_and_come_late(frames, step, gap, quality):
    with HandFollower(LiveOptions()) as follower:
        for i in range(14):
            follower.follow(Frame(1 + i * step, i * gap, frames[0].rgb))
        assert follower._networks.quality == quality


@pytest.mark.parametrize(("shift", "begins"), [(0, True), (250, False)])
def test_hand_begins_only_well_inside(frames, shift, begins):
    outside = [replace(f, rgb=np.roll(f.rgb, shift, axis=1)) for f in frames[:6]]
    for frame in outside:
        frame.rgb[:, :shift] = 128
    assert bool(followed(outside)[-1].hands) == begins


def test_other_hand_is_not_taken_for_the_wanted_one(frames, take):
    other = "left" if take.hands[0].side == "right" else "right"
    options = LiveOptions(CaptureOptions(hands=other))
    assert [pose for pose in followed(frames, options) if pose.hands] == []


def test_two_hands_are_told_apart():
    """The picture beside its mirror image."""
    shown = [cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB) for bgr in pictures(PATTERN, 2)]
    last = followed([Frame(i + 1, i / 24, rgb) for i, rgb in enumerate(shown)])[-1]
    assert [(hand.side, hand.state) for hand in last.hands] == [("left", "seen"), ("right", "seen")]
    left, right = (hand.keypoints.mean(axis=0) for hand in last.hands)
    assert left[0] + right[0] == pytest.approx(640, abs=8)


def test_size_may_change_on_the_way(frames):
    smaller = [replace(f, rgb=cv2.resize(f.rgb, (320, 240))) for f in frames[12:]]
    assert followed([*frames[:12], *smaller])[-1].hands[0].state == "seen"


# Sources


def test_live_plays_a_file():
    with contextlib.closing(live(CLIP)) as poses:
        found = list(poses)
    numbers = [pose.sequence for pose in found]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] == 24
    assert [t.name for t in threading.enumerate() if t.name == "handfit-live"] == []


def test_slow_consumer_gets_the_newest_frame_and_the_count_of_the_others():
    with LiveReader(LiveSource(file=PATTERN)) as reader:
        waited(lambda: reader.received == 24)
        assert reader.newest(1.0).number == 24
        assert (reader.received, reader.dropped) == (24, 23)
        assert reader.newest(1.0) is None
        assert reader.ended


def test_a_file_plays_in_a_loop_for_who_asks():
    with contextlib.closing(live(CLIP, LiveOptions(loop=True))) as poses:
        assert next(pose for pose in poses if pose.sequence > 40).hands
    assert [t.name for t in threading.enumerate() if t.name == "handfit-live"] == []


HERE = ("http://127.0.0.1:80/a", "https://localhost/a", "rtsp://[::1]:554/x")
ELSEWHERE = ("http://192.168.0.7:8080/video", "rtsp://phone.local/x", "http://127.0.0.1.example.org/x")


@pytest.mark.parametrize("address", [*HERE, *ELSEWHERE])
def test_addresses_of_others_want_permission(address):
    assert LiveSource.parse(address, online=True).address == address
    if address in HERE:
        assert LiveSource.parse(address).address == address
    else:
        with pytest.raises(OptionError, match="is another machine"):
            LiveSource.parse(address)


def test_schemes_in_capitals_are_the_same():
    """Or what comes over HTTP would be followed to other addresses."""
    assert LiveSource.parse("HTTP://127.0.0.1/Video").address == "http://127.0.0.1/Video"


@pytest.mark.parametrize(
    "text",
    ["", "no such camera", "-1", "ftp://127.0.0.1/x", "http://", "concat:a|b", "http://[::1", "\0"],
)
def test_what_is_no_source_is_one_sentence(text):
    with pytest.raises(OptionError) as raised:
        LiveSource.parse(text, online=True)
    assert "\n" not in str(raised.value)


def test_cameras_by_name(tmp_path):
    for number, name, index in ((0, "Integrated Camera", 0), (1, "Integrated Camera", 1), (2, "EOS R6", 0)):
        folder = tmp_path / f"video{number}"
        folder.mkdir()
        (folder / "name").write_text(name + "\n")
        (folder / "index").write_text(f"{index}\n")
    assert cameras(tmp_path) == [(0, "Integrated Camera"), (2, "EOS R6")]
    for text, number in (("eos", 2), ("Integrated camera", 0), ("7", 7)):
        assert LiveSource.parse(text, names=tmp_path).camera == number
    with pytest.raises(OptionError, match=r"0 \(Integrated Camera\), 2 \(EOS R6\)"):
        LiveSource.parse("Sony", names=tmp_path)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("999", "camera 999"),
        ("file:/nowhere/clip.mp4", "no such file"),
        (f"file:{ROOT / 'README.md'}", "this is a text"),
    ],
)
def test_what_cannot_be_opened_ends_in_a_sentence(source, said):
    with pytest.raises(InputError, match=said):
        list(live(source))


class Station:
    """A camera on 127.0.0.1 that can be silent, and sends all pictures to whoever connects."""

    def __init__(self, pictures: Iterable[np.ndarray | bytes]) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.address = f"http://127.0.0.1:{self.server.getsockname()[1]}/x"
        self.pictures, self.silent = pictures, True
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client = self.server.accept()[0]
                with client, contextlib.suppress(OSError):
                    client.recv(4096)
                    head = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n"
                    client.sendall(head)
                    while self.silent and client.recv(1):
                        pass
                    for one in self.pictures:
                        jpeg = one if isinstance(one, bytes) else cv2.imencode(".jpg", one)[1].tobytes()
                        part = b"--b\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
                        client.sendall(part + jpeg + b"\r\n")
                        time.sleep(0.02)


@pytest.fixture
def station(frames) -> Iterator[Station]:
    made = Station([frame.rgb for frame in frames])
    yield made
    made.server.close()


def test_address_that_stalls_is_told_of_and_tried_again(station, monkeypatch):
    monkeypatch.setattr(camera, "CAMERA", replace(camera.CAMERA, answer_seconds=0.3, retry_seconds=0.05))
    with LiveReader(LiveSource(address=station.address)) as reader:
        waited(lambda: reader.problem)
        assert "does not answer within 0.3 seconds" in reader.problem
        assert reader.newest() is None
        station.silent = False
        waited(lambda: reader.received > 30)  # more than one connection has
        waited(lambda: "sends no pictures any more" in reader.problem)


def test_address_that_sends_no_pictures_is_told_of(station, monkeypatch):
    monkeypatch.setattr(camera, "CAMERA", replace(camera.CAMERA, answer_seconds=1.0, retry_seconds=0.05))
    station.pictures, station.silent = itertools.repeat(b"x" * 100), False
    with LiveReader(LiveSource(address=station.address)) as reader:
        waited(lambda: "or sends no pictures that can be read" in reader.problem)


def test_damaged_pictures_are_passed_over(station, frames, tmp_path):
    """They are neither followed nor recorded."""
    good = cv2.imencode(".jpg", frames[0].rgb)[1].tobytes()
    station.pictures, station.silent = [b"junk", good[:1000], good], False
    with LiveReader(LiveSource(address=station.address)) as reader:
        reader.record(tmp_path / "a.mkv")
        waited(lambda: (frame := reader.newest(0.1)) is not None and frame.rgb.any())
        waited(lambda: reader.recording.frames > 1)
        written = reader.stop_recording()
    read = [frame.rgb for frame in open_media(tmp_path / "a.mkv").frames() if frame.rgb is not None]
    assert 0 < len(read) <= written.frames  # of two that come at once the later one counts
    assert all(np.abs(rgb.astype(int) - frames[0].rgb[..., ::-1]).mean() < 20.0 for rgb in read)


@pytest.mark.parametrize(
    ("scales", "size"), [((1.0, 0.5, 2.0), None), ((1.0,), 8)], ids=["sizes", "unplugged"]
)
def test_source_that_behaves_badly_is_followed_and_what_was_recorded_captured(
    station, frames, tmp_path, scales, size
):
    bgr = [frame.rgb[..., ::-1] for frame in frames[:size]]
    shown = [cv2.resize(one, None, fx=scale, fy=scale) for scale in scales for one in bgr]
    station.pictures, station.silent = shown, False
    states = set()
    with Live(station.address) as run:
        run.reader.record(tmp_path / "a.mkv")
        waited(lambda: run.reader.received)
        if size is not None:
            station.server.close()
        wanted = 8 if size is None else 3

        def is_enough() -> bool:
            pose = run.next()
            states.update(hand.state for hand in pose.hands) if pose is not None else None
            return run.reader.recording.frames >= wanted and "seen" in states

        waited(is_enough)
        if size is not None:
            waited(lambda: "sends no pictures any more" in run.reader.problem)
        written = run.reader.stop_recording()
    found = capture(tmp_path / "a.mkv")
    assert len(found.frame_numbers) == pytest.approx(1.0 + written.seconds * written.fps, abs=1.0)
    assert found.hands
    assert (found.width, found.height) == (640, 480)


@pytest.mark.parametrize(
    ("system", "allowed", "said"),
    [
        ("darwin", True, "System Settings > Privacy & Security > Camera"),
        ("linux", True, "close other programs that use it"),
        ("linux", False, "group 'video'"),
    ],
)
def test_why_a_camera_does_not_open(monkeypatch, system, allowed, said):
    monkeypatch.setattr(camera.sys, "platform", system)
    monkeypatch.setattr(camera.Path, "exists", lambda _: True)
    monkeypatch.setattr(camera.os, "access", lambda *_: allowed)
    assert said in camera._why_no_camera(0)


def test_playlists_are_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(camera, "CAMERA", replace(camera.CAMERA, answer_seconds=0.5, retry_seconds=0.05))
    asked: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        listing = f"#EXTM3U\n#EXTINF:9,\nhttp://127.0.0.1:{port}/secret.ts\n#EXT-X-ENDLIST\n".encode()

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    client = server.accept()[0]
                    with client:
                        asked.append(client.recv(4096))
                        head = b"HTTP/1.1 200 OK\r\nContent-Type: application/vnd.apple.mpegurl\r\n"
                        client.sendall(head + b"Content-Length: %d\r\n\r\n" % len(listing) + listing)

        threading.Thread(target=serve, daemon=True).start()
        with LiveReader(LiveSource(address=f"http://127.0.0.1:{port}/a.m3u8")) as reader:
            waited(lambda: reader.problem and len(asked) > 1)
    assert not [request for request in asked if b"secret" in request]


# Recordings


def written(path: Path, frames: list[Frame], times: list[float]) -> ClipWriter:
    writer = ClipWriter(path, 30.0)
    for frame, seconds in zip(frames, times, strict=True):
        writer.write(frame.rgb, 77.0 + seconds)
    writer.close()
    return writer


def test_a_recording_has_its_frames_at_a_constant_rate(tmp_path, frames):
    """A camera's jitter goes, and a break of five seconds stays one, in which there are no pictures."""
    times = np.arange(24) / 30.0 + np.random.default_rng(1).uniform(-0.004, 0.004, 24)
    times[12:] += 5.0
    writer = written(tmp_path / "a.mkv", frames, times.tolist())
    media = open_media(tmp_path / "a.mkv")
    assert media.fps == writer.fps == 30.0
    assert media.expected_frames == 24 + 150
    read = list(media.frames())
    shown = [frame.number for frame in read if frame.rgb is not None]
    assert shown == [*range(1, 13), *range(163, 175)]
    pictures = [frame.rgb for frame in read if frame.rgb is not None]
    apart = [np.abs(a.astype(int) - b.rgb).mean() for a, b in zip(pictures, frames, strict=True)]
    assert max(apart) < 3.0


def test_recording_that_is_cut_off_can_be_read(tmp_path, frames):
    path = tmp_path / "a.mkv"
    written(path, frames[:8], [i / 30 for i in range(8)])
    path.write_bytes(path.read_bytes()[:-1000])
    assert len([f for f in open_media(path).frames() if f.rgb is not None]) >= 7


def test_pictures_that_turn_keep_their_shape(tmp_path, frames, caplog):
    turned = [replace(frame, rgb=np.ascontiguousarray(frame.rgb.swapaxes(0, 1))) for frame in frames[:3]]
    written(tmp_path / "a.mkv", [*frames[:3], *turned], [i / 24.0 for i in range(6)])
    last = list(open_media(tmp_path / "a.mkv").frames())[5].rgb.astype(int)
    assert last.shape == (480, 640, 3)
    assert max(last[:, :138].max(), last[:, -138:].max()) < 12
    inside = cv2.resize(turned[2].rgb, (360, 480), interpolation=cv2.INTER_AREA)
    assert np.abs(last[:, 140:500] - inside).mean() < 3.0
    assert caplog.text.count("pictures of 480x640 follow those of 640x480") == 1


@pytest.mark.parametrize("what", ["deleted", "wide", "pause"])
def test_recording_that_cannot_go_on_says_why(tmp_path, frames, what):
    """It ends, and nobody waits for it."""
    said: list[str] = []
    (tmp_path / "takes").mkdir()
    recorder = camera.Recorder(tmp_path / "takes" / "a.mkv", 30.0, said.append)
    rgb = np.zeros((2, 70_000, 3), dtype=np.uint8) if what == "wide" else frames[0].rgb
    for i in range(100):
        if i == 4 and what == "deleted":
            waited(lambda: recorder.writer.frames == 4)
            shutil.rmtree(tmp_path / "takes")
        time.sleep(0.001)
        recorder.put(camera.LivePicture(i, i / 30.0 + 90.0 * (what == "pause" and i > 4), lambda: rgb))
    writer = recorder.close()
    words = {"deleted": "deleted or moved", "wide": "larger than a JPEG", "pause": "no picture came for 90"}
    assert len(said) == 1
    assert words[what] in said[0]
    assert (writer.failed, writer.frames) == (True, 5 if what == "pause" else 0)


def test_recorded_clip_is_captured_as_the_file(tmp_path):
    """What a live run records gives the take that a capture of that file gives."""
    path = tmp_path / "live.mkv"
    run = Live(CLIP)
    run.reader.record(path)  # before the source is opened, so that it has the first picture on a busy machine
    with run:
        for _ in run:
            pass
        assert run.reader.stop_recording().frames == 24
    found, again = capture(path), capture(path, processes=2)
    assert [hand.side for hand in found.hands] == [hand.side for hand in again.hands]
    for one, other in zip(found.hands, again.hands, strict=True):
        np.testing.assert_allclose(one.hand_pose, other.hand_pose, atol=1e-6)
    assert found.fps == pytest.approx(24.0, abs=3.0)


@pytest.mark.slow
def test_full_disk_keeps_what_was_written_and_captures_it(tmp_path):
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))

    command = [sys.executable, "-m", "handfit_core", "live", CLIP, "--progress", "json", "-o"]
    path = tmp_path / "a.npz"
    done = subprocess.run(
        [*command, str(path)], capture_output=True, text=True, cwd=ROOT, preexec_fn=limit, check=True
    )
    assert "which are kept" in done.stdout
    media = open_media(path.with_suffix(".mkv"))
    count = len(Take.load(path).frame_numbers)
    assert 0 < len(list(media.frames())) <= count < 24
    assert media.expected_frames == pytest.approx(count, abs=1)


def test_recordings_replace_nothing(tmp_path):
    (tmp_path / "a.mkv").write_text("mine")
    with pytest.raises(OutputError, match="cannot be recorded to"):
        ClipWriter(tmp_path / "a.mkv", 30.0)
    assert (tmp_path / "a.mkv").read_text() == "mine"


# The worker


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with stopping(Worker(threads=1)) as made:
        yield made


def until(worker: Worker, request: int, kind: str) -> dict[str, Any]:
    """The next event of that kind."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        for event in worker.events(request):
            if event["event"] in (kind, "error"):
                assert event["event"] == kind, event
                return event
    raise AssertionError(f"no {kind} came")


def test_worker_follows_records_and_answers_others_afterwards(worker, station, tmp_path):
    station.silent = False
    path = str(tmp_path / "take.mkv")
    request = worker.submit("live", source=station.address, options={}, live={"beta": 2.0}, picture=160)
    worker.tell(request, "live-record", output=path)
    pose = until(worker, request, "live")
    while not (pose["hands"] and pose["picture"] and (pose["recorded"] or 0) > 3):
        pose = until(worker, request, "live")
    (hand,) = pose["hands"]
    assert hand["state"] == "seen"
    sizes = {name: unpack(hand[name]).size for name in ("betas", "global_orient", "hand_pose", "transl")}
    assert list(sizes.values()) == [10, 3, 45, 3]
    assert unpack(pose["picture"]).shape == (120, 160, 3)
    assert (pose["size"], pose["intrinsics"]) == ([640, 480], [640.0, 640.0, 320.0, 240.0])
    worker.tell(request, "live-record", output=None)
    recorded = until(worker, request, "recorded")
    worker.cancel(request)
    done = wait_for(worker, request, timeout=PATIENCE)
    assert (recorded["output"], done["recording"]) == (path, None)
    assert done["frames"] >= done["shown"] > 0
    probed = wait_for(worker, worker.submit("probe", input=[path]), timeout=PATIENCE)["frames"]
    assert probed == pytest.approx(1.0 + recorded["seconds"] * recorded["fps"], abs=1.0)


def test_newest_pose_alone_waits_to_be_taken(worker, station):
    station.silent = False
    request = worker.submit("live", source=station.address, options={}, live={})
    first = until(worker, request, "live")
    for _ in range(20):
        time.sleep(0.05)
        worker._collect()
    events = [event for event in worker.events(request) if event["event"] == "live"]
    assert len(events) <= 1
    assert all(event["sequence"] > first["sequence"] for event in events)
    worker.cancel(request)
    wait_for(worker, request, timeout=PATIENCE)


@pytest.mark.parametrize(
    "fields",
    [
        {"source": "http://192.168.0.7/x"},
        {"source": CLIP, "live": {"bata": 1}},
        {"source": CLIP, "picture": 100_000},
        {"source": "file:/nowhere.mp4"},
    ],
)
def test_worker_says_what_is_wrong(worker, fields):
    with pytest.raises(HandfitError) as raised:
        wait_for(worker, worker.submit("live", **fields), timeout=PATIENCE)
    assert type(raised.value) in (OptionError, InputError)


def test_no_process_stays_when_its_client_is_gone(station):
    """Also one that waits for a camera that is silent."""
    worker = Worker(threads=1)
    worker.submit("live", source=station.address, options={}, live={})
    waited(lambda: worker.events() or worker.ready)
    pid = pid_of(worker)
    worker.stop(10.0)
    waited(lambda: not Path(f"/proc/{pid}").exists())


# Other programs


def test_osc_server_reads_what_is_sent(frames):
    from pythonosc.dispatcher import Dispatcher
    from pythonosc.osc_server import BlockingOSCUDPServer

    from handfit_core.capturing.live.send import LiveSender

    poses = followed(frames[:6])
    came: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
    dispatcher = Dispatcher()
    dispatcher.set_default_handler(lambda *message: came.put(message))
    with BlockingOSCUDPServer(("127.0.0.1", 0), dispatcher) as server:
        server.timeout = 1.0
        models = {side: load_model(None, side) for side in ("left", "right")}
        with LiveSender("127.0.0.1", server.server_address[1], models, wrist=True) as sender:
            sender.send(poses[0])
            sender.send(poses[-1])
        while came.empty() or server.socket in _readable(server.socket):
            server.handle_request()
    messages: dict[str, list[tuple[Any, ...]]] = {}
    while not came.empty():
        address, *values = came.get()
        messages.setdefault(address, []).append(tuple(values))
    assert messages["/VMC/Ext/OK"] == [(1,), (1,)]
    assert messages["/VMC/Ext/T"][0] == (0.0,)
    numbers, ages = zip(*messages["/handfit/frame"], strict=True)
    assert numbers == (poses[0].sequence, poses[-1].sequence)
    assert all(isinstance(age, float) for age in ages)
    sent = messages["/VMC/Ext/Bone/Pos"]
    assert len(sent) == 2 * 16
    side = poses[-1].hands[0].side.title()
    assert {f"{side}IndexProximal", f"{side}ThumbDistal"} <= {name for name, *_ in sent}
    for _, *values in sent:
        assert np.linalg.norm(values[3:]) == pytest.approx(1.0, abs=1e-5)
    hands = [values[3:] for name, *values in sent if name == f"{side}Hand"]
    first, last = (rotvec_to_rotmat(pose.hands[0].global_orient) for pose in (poses[0], poses[-1]))
    np.testing.assert_allclose(np.abs(hands[0]), [0.0, 0.0, 0.0, 1.0], atol=1e-6)
    assert abs(hands[1][3]) == pytest.approx(abs(rotmat_to_quat(first.T @ last)[0]), abs=1e-5)
    assert abs(hands[1][3]) < 1.0 - 1e-6


def _readable(sock: socket.socket) -> list[socket.socket]:
    import select

    return select.select([sock], [], [], 0.05)[0]


def test_command_records_and_captures(tmp_path):
    command = [sys.executable, "-m", "handfit_core", "live", CLIP, "--progress", "json"]
    done = subprocess.run(
        [*command, "-o", str(tmp_path / "a.npz")], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert '"event": "live"' in done.stdout
    assert '"event": "done"' in done.stdout
    assert (tmp_path / "a.npz").exists()
    assert (tmp_path / "a.mkv").exists()


def test_stamps_survive_jpeg():
    bgr = stamped(np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8), 12345.6789)
    again = cv2.imdecode(cv2.imencode(".jpg", bgr)[1], cv2.IMREAD_COLOR)
    assert stamp_of(again) == pytest.approx(12345.6789, abs=2e-4)


def test_one_euro_is_its_formula():
    rng = np.random.default_rng(5)
    values, seconds, min_cutoff, beta = rng.normal(size=40).cumsum(), rng.uniform(0.01, 0.1, 40), 1.3, 0.4
    filtering, filtered, expected = OneEuro(min_cutoff, beta), values[0], [values[0]]
    found, speed = [filtered], None

    def alpha(cutoff: float, te: float) -> float:
        tau = 1.0 / (2.0 * np.pi * cutoff)
        return 1.0 / (1.0 + tau / te)

    for before, value, te in zip(values, values[1:], seconds, strict=False):
        gain = filtering.gain(np.array([[value - before]]), te)
        filtered += gain[0, 0] * (value - filtered)
        found.append(filtered)
        rate = (value - before) / te
        speed = rate if speed is None else speed + alpha(1.0, te) * (rate - speed)
        a = alpha(min_cutoff + beta * abs(speed), te)
        expected.append(a * value + (1.0 - a) * expected[-1])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
