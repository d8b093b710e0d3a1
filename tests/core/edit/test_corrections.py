"""Corrections fade out as promised and can be written as text."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.common.errors import TakeError
from handfit_core.edit.corrections import (
    Correction,
    CorrectionField,
    changed_quats,
    changed_segments,
    correction_between,
)
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from tests.corrections import correction, random_field


@pytest.mark.parametrize(
    ("frames", "spread", "at", "weights"),
    [
        ([10, 13, 30], 6.0, [10, 13, 30], np.eye(3)),
        ([10, 14], 6.0, [10, 11, 12, 14], [[1, 0], [0.84375, 0.15625], [0.5, 0.5], [0, 1]]),
        ([20], 5.0, [15, 17.5, 20, 22.5, 25, 28], [[0], [0.5], [1], [0.5], [0], [0]]),
        ([20], 0.0, [19, 19.99, 20, 20.01], [[0], [0], [1], [0]]),
    ],
)
def test_weights(frames, spread, at, weights):
    """A smoothstep over the spread, or over what lies between two corrections where that is less."""
    np.testing.assert_allclose(random_field(1, frames, spread).weights(np.array(at)), weights, atol=1e-12)


def test_changed_segments():
    """Against the definition, on a fine grid, for corrections that come, go and change."""
    rng, grid = np.random.default_rng(5), np.linspace(0, 100, 2001)
    for seed in range(60):
        spread = float(rng.integers(0, 15))
        old = random_field(seed, rng.choice(100, rng.integers(0, 6), replace=False), spread)
        new = old.without(rng.choice(sorted(old.corrections) or [0], 1))
        for frame in rng.choice(100, rng.integers(0, 3), replace=False):
            new = new.having({int(frame): correction(rng, float(rng.integers(0, 15)))})
        inside = np.zeros(len(grid), dtype=bool)
        for first, last in changed_segments(old, new):
            inside |= (grid >= first) & (grid <= last)
        for before, after in zip(old.at(grid), new.at(grid), strict=True):
            np.testing.assert_allclose(before[~inside], after[~inside], atol=1e-12)


def test_correction_between():
    before, after = np.random.default_rng(2).normal(size=(2, 50, 4))
    before[0] *= 3.0  # keys need not be of unit length
    turns = correction_between(before, after)
    found = quat_to_rotmat(before) @ rotvec_to_rotmat(turns)
    np.testing.assert_allclose(found, quat_to_rotmat(after), atol=1e-9)
    assert np.linalg.norm(turns, axis=-1).max() <= np.pi


def test_a_change_and_back_is_nothing():
    rng = np.random.default_rng(4)
    quats, (old, new) = rng.normal(size=(30, 16, 4)), rng.normal(scale=1.5, size=(2, 30, 16, 3))
    there = changed_quats(quats, old, new)
    base = quat_to_rotmat(quats) @ np.swapaxes(rotvec_to_rotmat(old), -1, -2)
    np.testing.assert_allclose(quat_to_rotmat(there), base @ rotvec_to_rotmat(new), atol=1e-9)
    np.testing.assert_allclose(changed_quats(there, new, old), quats, atol=1e-9)


def test_text_is_what_older_scenes_hold():
    one = Correction({8: (1, 2.5)}, location=np.array([0.5, 0.0, 0.0]), spread=3, posed=True, touches={8: 4})
    field = CorrectionField({5: Correction({}, added_key=True), 7: one})
    assert field.to_json() == (
        '{"version":1,"frames":{"5":{"pins":{},"spread":0.0,"added_key":true},"7":{"pins":{"8":[1.0,2.5]},'
        '"spread":3.0,"added_key":false,"posed":true,"touches":{"8":4},"location":[0.5,0.0,0.0]}}}'
    )
    assert CorrectionField().to_json() == ""
    for each in (field, random_field(7, [3, 12])):
        assert CorrectionField.from_json(each.to_json()).to_json() == each.to_json()


def test_pins_of_a_second_view_are_passed_over():
    """Scenes of earlier versions have them."""
    text = CorrectionField({4: Correction({8: (1.0, 2.0)})}).to_json()
    older = text.replace('"spread"', '"second_pins":{"4":[1.5,2.0]},"spread"')
    assert older != text
    assert CorrectionField.from_json(older).to_json() == text


@pytest.mark.parametrize(
    "text",
    [
        "no json",
        '{"version":1,"frames":[]}',
        '{"version":1e999,"frames":{}}',
        '{"version":1,"frames":{"3":{"pins":{"21":[1,2]},"spread":1}}}',
        '{"version":1,"frames":{"3":{"pins":{},"spread":NaN}}}',
        '{"version":1,"frames":{"3":{"pins":{},"spread":1,"rotation":[1]}}}',
        '{"version":1,"frames":{"3":{"pins":{},"spread":1,"touches":{"8":7}}}}',
        '{"version":1,"frames":' + "[" * 100_000,
    ],
    ids=lambda text: text[:60],
)
def test_what_is_no_correction_is_refused(text):
    with pytest.raises(TakeError, match="corrections"):
        CorrectionField.from_json(text)


def test_field_is_zero_at_new_keys():
    """On any of them, whatever is corrected around, between, or cleared afterwards."""
    rng = np.random.default_rng(6)
    for seed in range(60):
        old = random_field(
            seed, rng.choice(30, rng.integers(1, 7), replace=False), float(rng.integers(0, 12))
        )
        frames = np.sort(rng.choice(30, rng.integers(1, 8), replace=False)).astype(float)
        frames[0] += 0.25 * rng.integers(0, 2)
        whole = bool(rng.integers(0, 2))
        new = old.keyed_anew(frames, whole=whole, keep_pins=bool(rng.integers(0, 2)))
        asked = np.linspace(frames[0], frames[-1], 200) if whole else frames
        for one in (new, new.cleared(rng.choice(new.frames, 1)) if len(new.frames) else new):
            for values in CorrectionField.from_json(one.to_json()).at(asked):
                np.testing.assert_allclose(values, 0.0, atol=1e-12)
        assert not new.cleared(new.corrected).corrections


def test_other_joints_keep_corrections():
    old = random_field(3, [10, 20], spread=8.0)
    for frame in (10.0, 12.0, 17.5):
        new = old.keyed_anew([frame], joints=range(1, 16), location=False, keep_pins=True)
        before, after = old.at(np.array([frame])), new.at(np.array([frame]))
        np.testing.assert_allclose(after[0][:, 0], before[0][:, 0], atol=1e-7)
        np.testing.assert_allclose(after[1], before[1], atol=1e-7)
        assert not after[0][:, 1:].any()
        assert new.corrected == [10, 20]
        assert not new.cleared([10, 20]).corrections
