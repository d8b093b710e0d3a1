"""The memory part, on clips of a few frames."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import SAMPLE
from benchmarks.memory import measure_memory, write_clip
from benchmarks.memory_child import peak_memory
from handfit_core.errors import InputError
from handfit_core.media.opening import open_media
from tests.conftest import ROOT


def test_clip_goes_there_and_back_again(tmp_path: Path) -> None:
    media = open_media(write_clip(SAMPLE, tmp_path / "long.mp4", 60))
    assert (media.width, media.height, media.expected_frames) == (320, 240, 60)
    pictures = [f.rgb.astype(int) for f in media.frames() if f.rgb is not None]
    assert len(pictures) == 60
    # 24 pictures: frames 24 and 46 are the turning points' neighbours, 46 is the first again.
    assert np.abs(pictures[25] - pictures[21]).mean() < 4
    assert np.abs(pictures[46] - pictures[0]).mean() < 4
    assert np.abs(pictures[23] - pictures[12]).mean() > 6


def test_peak_is_of_the_process_itself() -> None:
    """Not of its parent, which is what getrusage starts with."""
    ballast = np.ones(400_000_000 // 8)
    code = "from benchmarks.memory_child import peak_memory; print(peak_memory())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert peak_memory() > ballast.nbytes / 1e6
    assert 5 < float(done.stdout) < 300


def test_peaks_of_both_lengths() -> None:
    told: list[int] = []
    peaks = measure_memory(SAMPLE, (2, 4), on_clip=told.append)
    assert told == [2, 4]
    assert [p.frames for p in peaks] == [2, 4]
    for peak in peaks:
        assert 50 < peak.detection <= peak.whole
    # Joints, keypoints and parameters of every frame: twice the frames, twice the arrays but for the shape.
    assert peaks[1].take == pytest.approx(2 * peaks[0].take, rel=0.1)
    assert json.dumps(peaks[0].frames)


def test_failure_of_the_capture_is_an_error(tmp_path: Path) -> None:
    import cv2

    grey = tmp_path / "grey.png"
    grey.write_bytes(cv2.imencode(".png", np.full((64, 64, 3), 99, np.uint8))[1].tobytes())
    with pytest.raises(InputError, match=r"a clip of 3 frames failed: .*no hand"):
        measure_memory(str(grey), (3,))
