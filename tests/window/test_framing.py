"""After a capture the picture is in sight, all of it, whatever the window looks like."""

from __future__ import annotations

import subprocess
import sys

import pytest

PORTRAIT = "import sys, cv2; p = cv2.imread(sys.argv[1]); cv2.imwrite(sys.argv[2], p[:, 160:460])"


@pytest.mark.parametrize("window", ["blender", "small_blender"])
def test_a_portrait_picture_is_framed_whole(request, window, rendered_hand, tmp_path):
    portrait = tmp_path / "portrait.jpg"
    subprocess.run(
        [sys.executable, "-c", PORTRAIT, str(rendered_hand / "hand.0001.jpg"), str(portrait)], check=True
    )
    blender = request.getfixturevalue(window)
    layouts = blender.play("framing.whole_picture", source=portrait, timeout=240).value
    for layout, seen in layouts.items():
        left, bottom, right, top = seen["picture"]
        assert (top - bottom) / (right - left) == pytest.approx(480 / 300, rel=0.01), layout
        free = seen["view"]
        assert free[0] <= left < right <= free[2], (layout, seen)
        assert free[1] <= bottom < top <= free[3], (layout, seen)
        for cover in seen["over"]:
            beside = cover[0] >= right - 1 or cover[2] <= left + 1
            beside |= cover[1] >= top - 1 or cover[3] <= bottom + 1
            assert beside, (layout, seen)
        # No smaller than need be: in a small window the sidebar leaves little width.
        assert top - bottom > 0.75 * (free[3] - free[1]) or right - left > 0.3 * (free[2] - free[0]), layout
