"""Contact sheets: which frames they show, of which pictures, and where the hands lie on them."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import OutputError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.media.pictures import read_picture
from handfit_core.media.source import Source
from handfit_core.take import Take
from handfit_core.take.sheet import write_sheet
from tests.takes import seen_as, take_of, track_of

WIDTH, HEIGHT, COUNT = 320, 240, 12
CAMERA = Intrinsics(320.0, 320.0, 160.0, 120.0)
GAP = 4
TRANSL = np.array([0.03, 0.0, 0.4])


def brightness(row: int) -> int:
    """Of the whole picture of a row, by which it is known again."""
    return 40 + 15 * row


def files_of(kind, folder):
    pictures = [np.full((HEIGHT, WIDTH, 3), brightness(row), dtype=np.uint8) for row in range(COUNT)]
    if kind == "video":
        path = folder / "grey.avi"
        video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (WIDTH, HEIGHT))
        for picture in pictures:
            video.write(picture)
        video.release()
        return (str(path),)
    paths = [str(folder / f"grey.{row + 1:04d}.png") for row in range(COUNT if kind == "sequence" else 1)]
    for path, picture in zip(paths, pictures, strict=False):
        cv2.imwrite(path, picture)
    return tuple(paths)


def take_with(source: Source | None = None, count: int = COUNT, worst: int | None = None) -> Take:
    """A hand that stands still; in row `worst`, if any, it is likely to be off by 20 mm, elsewhere by 4."""
    error = np.full((count, 5), 0.004)
    error[() if worst is None else worst] = 0.004 if worst is None else 0.02
    orient, pose = np.zeros((count, 3)), np.zeros((count, 45))
    hand = track_of("right", orient, pose, np.tile(TRANSL, (count, 1)), CAMERA, expected_error=error)
    fields = {} if source is None else {"source": source}
    return take_of([hand], CAMERA, WIDTH, HEIGHT, **fields)


def cells_of(path: Path, height: int = HEIGHT) -> list[np.ndarray]:
    """The frames on a sheet, as numbers that can be subtracted."""
    sheet = read_picture(path)[0].astype(int)
    width = round(WIDTH * height / HEIGHT)
    count = (sheet.shape[1] + GAP) // (width + GAP)
    assert sheet.shape == (height, count * (width + GAP) - GAP, 3)
    return [sheet[:, at * (width + GAP) :][:, :width] for at in range(count)]


def is_hand(cell: np.ndarray) -> np.ndarray:
    """(H, W) where a hand is drawn: nothing else is blue."""
    return cell[..., 2] - cell[..., 0] > 25


@pytest.mark.parametrize("kind", ["photo", "sequence", "video"])
def test_each_frame_is_its_own_picture(kind, tmp_path):
    source = Source(kind, files_of(kind, tmp_path))
    take = take_with(source, 1 if kind == "photo" else COUNT)
    numbers = write_sheet(take, tmp_path / "a.sheet.jpg")
    assert numbers == ([1] if kind == "photo" else [1, 5, 8, 12])
    cells = cells_of(tmp_path / "a.sheet.jpg")
    assert [cell[5, 5].mean() for cell in cells] == pytest.approx([brightness(n - 1) for n in numbers], abs=4)
    assert all(is_hand(cell).any() for cell in cells)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_hand_lies_where_the_camera_sees_it(side, tmp_path):
    """Its outline's box on the sheet is that of the mesh in the picture, and the keypoints lie in it."""
    rng, count = np.random.default_rng(3), 2
    orient, pose = rng.normal(0.0, 0.8, (count, 3)), rng.normal(0.0, 0.15, (count, 45))
    model = load_model(None, side)
    centre = model.posed(None, orient, pose, np.zeros((count, 3))).vertices.mean(axis=1)
    hand = track_of(side, orient, pose, np.array([0.0, 0.0, 0.5]) - centre, CAMERA)
    write_sheet(take_of([hand], CAMERA, WIDTH, HEIGHT), tmp_path / "a.jpg", height=HEIGHT)
    posed = model.posed(None, orient, pose, hand.transl)
    for row, cell in enumerate(cells_of(tmp_path / "a.jpg")):
        drawn, pixels = is_hand(cell), CAMERA.project(posed.vertices[row])
        rows, columns = np.nonzero(drawn)
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        np.testing.assert_allclose(box, [*pixels.min(axis=0), *pixels.max(axis=0)], atol=3.0)
        x, y = CAMERA.project(posed.keypoints[row]).astype(int).T
        assert drawn[y, x].mean() > 0.9


def test_the_most_doubtful_frame_is_among_them_and_named(tmp_path):
    numbers = write_sheet(take_with(worst=6), tmp_path / "a.jpg")
    assert 7 in numbers
    assert len(numbers) == 4
    named = [(cell[-24:, :, 0] - cell[-24:, :, 2] > 80).any() for cell in cells_of(tmp_path / "a.jpg")]
    assert named == [number == 7 for number in numbers]


def test_small_hands_are_shown_close_up_behind_the_whole_picture(tmp_path):
    """The picture is bright where the hand is, so that the close-up holds that part of it."""
    orient, pose, far = np.zeros((1, 3)), np.zeros((1, 45)), np.array([[0.5, 0.3, 2.0]])
    hand = track_of("right", orient, pose, far, CAMERA)
    low, high = hand.keypoints_2d[0].min(axis=0), hand.keypoints_2d[0].max(axis=0)
    picture = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    cv2.rectangle(picture, low.astype(int).tolist(), high.astype(int).tolist(), (200, 200, 200), -1)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    take = take_of([hand], CAMERA, WIDTH, HEIGHT, source=Source("photo", (str(tmp_path / "a.png"),)))
    assert write_sheet(take, tmp_path / "a.jpg") == [1]
    whole, close = cells_of(tmp_path / "a.jpg")
    # What is not black, without the line that says the number: the bright part with the hand over it.
    boxes = [np.nonzero(cell[:200].max(axis=-1) > 60) for cell in (whole, close)]
    small, large = (np.array([np.ptp(at) + 1 for at in box]) for box in boxes)
    np.testing.assert_allclose(small, (high - low)[::-1] + 1, atol=6)
    zoom = 1.0 / max(1.6 * (high - low) / [WIDTH, HEIGHT])
    np.testing.assert_allclose(large / small, zoom, rtol=0.1)
    assert [at.mean() for at in boxes[1]] == pytest.approx([HEIGHT / 2, WIDTH / 2], abs=20)


def test_frames_without_a_hand_are_not_shown(tmp_path):
    take = take_with()
    (hand,) = take.hands
    detected = np.arange(COUNT) >= 8
    take = replace(take, hands=(seen_as(hand, detected=detected),))
    assert write_sheet(take, tmp_path / "a.jpg", frames=2) == [9, 12]
    assert write_sheet(replace(take, hands=()), tmp_path / "b.jpg", frames=2) == [1, 12]
    assert not any(is_hand(cell).any() for cell in cells_of(tmp_path / "b.jpg"))


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("video", None),
        ("photo", cv2.imencode(".png", np.zeros((20, 30, 3), dtype=np.uint8))[1].tobytes()),
        ("video", b"\0\0\0\x18ftypmp42" + bytes(100)),
    ],
    ids=["gone", "of another size", "damaged"],
)
def test_without_its_footage_the_hand_stands_on_plain_ground(kind, content, tmp_path):
    file = tmp_path / ("a.png" if kind == "photo" else "a.mp4")
    if content is not None:
        file.write_bytes(content)
    write_sheet(take_with(Source(kind, (str(file),))), tmp_path / "a.jpg", frames=2)
    for cell in cells_of(tmp_path / "a.jpg"):
        assert np.ptp(cell[:20]) < 6
        assert is_hand(cell).any()


@pytest.mark.parametrize("away", [TRANSL, np.array([0.0, 0.0, 0.02])], ids=["without its model", "too near"])
def test_without_its_model_or_too_near_the_skeleton_is_drawn(away, tmp_path):
    take = take_with()
    (hand,) = take.hands
    near = replace(hand, transl=hand.transl - TRANSL + away)
    take = replace(take, hands=(near,), model="/nowhere/MANO_RIGHT.pkl" if away is TRANSL else take.model)
    write_sheet(take, tmp_path / "a.jpg", frames=1)
    (cell,) = cells_of(tmp_path / "a.jpg")
    drawn = is_hand(cell)
    x, y = hand.keypoints_2d[0].astype(int).T
    beside = cv2.dilate(drawn.astype(np.uint8), np.ones((3, 3)))
    assert beside[y, x].all()
    assert drawn.mean() < 0.1


def test_wide_and_tall_pictures_stay_within_a_sheet(tmp_path):
    for width, height, expected in ((4000, 100, (60, 4 * 124 - 4)), (100, 4000, (60, 4 * 6 - 4))):
        take = replace(take_with(), width=width, height=height, hands=())
        write_sheet(take, tmp_path / "a.jpg", height=60)
        assert read_picture(tmp_path / "a.jpg")[0].shape[:2] == expected
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write here"):
        write_sheet(take_with(), tmp_path / "file" / "a.jpg")
