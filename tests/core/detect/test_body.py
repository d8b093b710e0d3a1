"""The body networks, and the pass that finds the bodies of hands."""

import zipfile

import cv2
import numpy as np
import pytest

from handfit_core import capture
from handfit_core.capturing.detection import find_in_frame
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import add_arms
from handfit_core.common.arrays import arrays_of
from handfit_core.common.errors import LandmarkModelError
from handfit_core.detect.bodies import FOLLOWING, find_bodies
from handfit_core.detect.body import WRISTS, BodyNetworks, crop_about
from handfit_core.detect.landmark_model import BODY, body_model_path
from handfit_core.detect.tflite import with_image_metadata
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import turn_from_axis
from handfit_core.media.opening import open_media
from handfit_core.media.pictures import read_picture
from handfit_core.take import Take
from tests.conftest import ROOT

PAINTED, SIGNER, TWO = (
    "photos/mona_lisa.jpg",
    "many_hands/panoptic_ex2_2.flv_000040_l.jpg",
    "many_hands/mpii_052475643.jpg",
)


@pytest.fixture(scope="module")
def networks():
    try:
        with BodyNetworks() as networks:
            yield networks
    except LandmarkModelError as error:
        pytest.skip(str(error))


def hands_in(path):
    """Keypoints (N, 21, 2) of a photo's hands, the surest first."""
    return find_in_frame(str(path), CaptureOptions())[1].keypoints_2d


def on_canvas(rgb, x, y, width=900, height=900):
    """The picture at that place of a grey one."""
    canvas = np.full((height, width, 3), 128, np.uint8)
    canvas[y : y + rgb.shape[0], x : x + rgb.shape[1]] = rgb
    return canvas


def test_the_crop_is_about_the_hips_and_upright():
    hips, above = np.array([300.0, 200.0]), np.array([380.0, 260.0])
    crop = crop_about(np.stack([hips, above]))
    placed = np.stack([hips, above]) @ crop.linear.T + crop.offset
    np.testing.assert_allclose(placed, [[128.0, 128.0], [128.0, 128.0 - 128.0 / 1.25]])


def test_outputs_that_are_left_out_change_no_other(networks, samples):
    """The file on the disk has the pruned network, in whose bytes the whole one still lies."""
    with zipfile.ZipFile(body_model_path()) as task:
        pruned = task.read(BODY.landmarks[0])
    whole = pruned[4096:]
    names = ("landmarks", "presence", "segmentation", "heat maps", "world")
    kept = [names[i] for i in BODY.landmarks_kept]
    assert with_image_metadata(whole, 0.0, 255.0, kept, BODY.landmarks_kept) == pruned
    rgb = cv2.resize(read_picture(samples / SIGNER)[0], (256, 256))
    vision, mp = networks._mp.tasks.vision, networks._mp
    outputs = []
    for network in (with_image_metadata(whole, 0.0, 255.0, names), pruned):
        options = vision.ImageEmbedderOptions(mp.tasks.BaseOptions(model_asset_buffer=network))
        with vision.ImageEmbedder.create_from_options(options) as embedder:
            found = embedder.embed(mp.Image(image_format=mp.ImageFormat.SRGB, data=rgb)).embeddings
        outputs.append({output.head_name: output.embedding for output in found})
    assert (list(outputs[0]), list(outputs[1])) == (list(names), kept)
    for name in kept:
        np.testing.assert_array_equal(outputs[1][name], outputs[0][name])


def test_where_a_person_stands_turns_its_world_points_alone(networks, samples):
    rgb = cv2.resize(read_picture(samples / SIGNER)[0], (200, 150))
    camera = Intrinsics(900.0, 900.0, 450.0, 450.0)
    axis, shift = np.array([[95.0, 140.0], [95.0, 40.0]]), np.array([420.0, 300.0])
    seen = []
    for x, y in ((200, 200), (620, 500)):
        place = np.array([x, y])
        body = networks.predict(on_canvas(rgb, x, y), axis + place, camera)
        ray = camera.rays(axis[0] + place)
        seen.append((body, turn_from_axis(ray / np.linalg.norm(ray))))
    (one, turn), (other, other_turn) = seen
    assert one.presence > 0.9
    np.testing.assert_allclose(other.keypoints, one.keypoints + shift, atol=0.01)
    np.testing.assert_allclose(other.world @ other_turn, one.world @ turn, atol=1e-4)
    assert np.abs(other.world - one.world).max() > 0.05


@pytest.mark.parametrize(
    ("name", "people", "held"), [(PAINTED, 1, 2), pytest.param(TWO, 2, 3, marks=pytest.mark.slow)]
)
def test_the_hands_of_a_photo_have_their_bodies(networks, samples, name, people, held):
    hands = hands_in(samples / name)
    media = open_media(str(samples / name))
    camera = Intrinsics.assumed(media.width, media.height)
    bodies = find_bodies(media, [1], list(hands[:, None]), camera)
    assert len(bodies) == people
    wrists = np.concatenate([body.keypoints[0, [*WRISTS.values()]] for body in bodies])
    off = np.linalg.norm(hands[:, None, 0] - wrists, axis=-1).min(axis=1) / np.ptp(hands, axis=1).max(axis=1)
    assert (off < 0.5).sum() == held
    assert all(body.score[0] > 0.6 for body in bodies)


@pytest.mark.slow
def test_clips_with_a_cut_have_equal_bodies_from_any_number_of_threads(networks, samples, tmp_path):
    """A painted woman, then somebody else, over three chunks; no hand is in the frames in between."""
    path, size, cut = tmp_path / "clip.avi", (300, 300), 130
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, size)
    hands = np.full((2, 210, 21, 2), np.nan)
    for name, frames in ((PAINTED, range(cut)), (SIGNER, range(cut, 210))):
        rgb, found = read_picture(samples / name)[0], hands_in(samples / name)[:2]
        factor = 280.0 / max(rgb.shape[:2])
        small = cv2.resize(rgb, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        for frame in frames:
            x = 5 + round(5 * np.sin(frame / 10.0))
            writer.write(on_canvas(small, x, 5, *size)[..., ::-1].copy())
            if not 100 <= frame < 110:
                hands[:, frame] = found * factor + [x, 5]
    writer.release()
    tracks = []
    for threads in (1, 3):
        media = open_media(str(path))
        tracks.append(find_bodies(media, range(1, 211), list(hands), Intrinsics.assumed(*size), threads))
    assert [len(each) for each in tracks] == [1, 1]
    ((one,), (other,)) = tracks
    for name in ("keypoints", "visibility", "world", "score", "present", "cut"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert not one.present[101:109].any()
    assert one.cut[cut]
    assert set(np.flatnonzero(one.cut)) <= {cut - 1, cut}
    assert one.present[:100].mean() > 0.9
    wrists = one.keypoints[:, [*WRISTS.values()]]
    off = np.linalg.norm(hands[:, :, None, 0] - wrists, axis=-1).min(axis=2) / np.ptp(hands, axis=2).max(-1)
    assert np.nanmedian(off) < 0.4
    # Nothing is interpolated between the two people.
    for shot in (slice(110, cut), slice(cut, 210)):
        shoulders = one.keypoints[shot, 11:13]
        assert np.nanmax(np.abs(shoulders - np.nanmedian(shoulders, axis=0))) < 25.0
    assert np.isfinite(one.score).sum() <= 210 / FOLLOWING.detection_interval * 4


@pytest.mark.slow
def test_through_a_measured_lens_hands_and_elbows_are_where_they_are_without(networks, tmp_path):
    """A painting as a wide lens would show it: hands move by 20 pixels, elbows as well."""
    path = ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg"
    straight = cv2.imread(str(path))
    height, width = straight.shape[:2]
    camera = Intrinsics(0.8 * height, 0.8 * height, width / 2.0, height / 2.0)
    lens = Lens(camera, (-0.25, 0.08, 0.0, 0.0, 0.0), width, height)
    seen = lens.undistorted(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1) + 0.5)
    at = (seen - 0.5).astype(np.float32)
    bent = cv2.remap(straight, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    cv2.imwrite(str(tmp_path / "bent.png"), bent)
    of = {hand.side: hand for hand in capture(path, arms=True, intrinsics=camera).hands}
    elbows = []
    taken = capture(tmp_path / "bent.png", arms=True, lens=lens)
    for hand in taken.hands:
        off = np.linalg.norm(hand.keypoints_2d - of[hand.side].keypoints_2d, axis=-1)
        assert off.mean() < 5.0
        elbow, other = (camera.project(each.arm.elbow[0]) for each in (hand, of[hand.side]) if each.arm)
        elbows.append(np.linalg.norm(elbow - other))
    assert np.mean(elbows) < 15.0  # and 23 without
    later = add_arms(Take.from_bytes(taken.to_bytes(compact=False)))
    for hand, again in zip(taken.hands, later.hands, strict=True):
        for name, points in arrays_of(hand.arm).items():
            np.testing.assert_array_equal(getattr(again.arm, name), points)


@pytest.mark.slow
@pytest.mark.usefixtures("networks")
def test_a_capture_with_arms_has_the_side_that_the_body_names(samples):
    """A man from behind, who holds up his left hand."""
    photo = str(samples / "many_hands" / "mpii_051423444.jpg")
    # Some processors find a hand in a traffic cone, too.
    there = {"regions": [(800, 280, 65, 75)], "only_regions": True}
    sides = [[hand.side for hand in capture(photo, arms=arms, **there).hands] for arms in (False, True)]
    assert sides == [["right"], ["left"]]
