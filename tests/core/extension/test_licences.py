from __future__ import annotations

import dataclasses

import pytest

from scripts.extension.licences import is_expression, licence_name, third_party_licences


@pytest.mark.parametrize(
    ("headers", "name", "expression"),
    [
        ("License-Expression: BSD-3-Clause AND MIT", "BSD-3-Clause AND MIT", True),
        ("License: Apache 2.0", "Apache 2.0", False),
        ("Classifier: License :: OSI Approved :: BSD License", "BSD License", False),
        ("License: " + "all of it " * 20 + "\nClassifier: License :: OSI Approved :: X", "X", False),
        ("Summary: says nothing", "see its licence files", False),
    ],
)
def test_a_licence_by_its_name(make_wheel, headers, name, expression):
    wheel = make_wheel("part-1-py3-none-any.whl", headers)
    assert licence_name(wheel) == name
    assert is_expression(wheel) == expression


@pytest.mark.parametrize(
    ("file_name", "libraries", "expression"),
    [
        (
            "opencv_python_headless-4.11.0.86-cp37-abi3-win_amd64.whl",
            ["cv2/opencv_videoio_ffmpeg4110_64.dll"],
            "Apache-2.0 AND LGPL-2.1-or-later",
        ),
        (
            "opencv_python_headless-4.11.0.86-cp37-abi3-macosx_13_0_arm64.whl",
            ["cv2/.dylibs/libavcodec.61.19.100.dylib", "cv2/.dylibs/libx264.164.dylib", "cv2/libssl.3.dylib"],
            "Apache-2.0 AND LGPL-2.1-or-later AND GPL-2.0-or-later",
        ),
        (
            "scipy-1.15.3-cp311-cp311-manylinux_2_28_x86_64.whl",
            ["scipy.libs/libquadmath-1.so", "scipy.libs/libgfortran-1.so"],
            "BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1 AND LGPL-2.1-or-later",
        ),
        (
            "scipy-1.15.3-cp311-cp311-win_amd64.whl",
            ["scipy.libs/libscipy_openblas.dll"],
            "BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1",
        ),
    ],
)
def test_libraries_inside_a_wheel_bring_their_licences(make_wheel, file_name, libraries, expression):
    wheel = make_wheel(file_name, "License: Apache 2.0", files=dict.fromkeys(libraries, ""))
    assert licence_name(wheel) == expression
    assert is_expression(wheel)


def test_licence_files_beside_the_code_are_taken_and_code_is_not(make_wheel, contents):
    files = {
        "part/_lib/_uarray/LICENSE": "Uarray's terms",
        "part/fft/_pocketfft/LICENSE.md": "Pocketfft's terms",
        "part/qhull_src/COPYING.txt": "Qhull's terms",
        "part/integrate/LICENSE_DOP": "DOP's terms",
        "part/license.py": "A module",
        "part/LICENSES.py": "Another module",
    }
    wheel = make_wheel("part-1-py3-none-any.whl", files=files)
    text = third_party_licences(dataclasses.replace(contents, wheels=((wheel, ("3.11",)),)))
    assert [name for name, words in files.items() if words in text] == list(files)[:4]


def test_others_licences_and_texts_stand_in_the_file(contents):
    text = third_party_licences(contents)
    for heading in (
        "torch 2.13.0+cpu",
        "mediapipe 0.10.31",
        "MediaPipe hand landmark model 0.10.21",
        "Open hand 1",
    ):
        assert text.count(f"\n{heading}\n{'=' * 100}\n") == 1
    assert "The licence of torch." in text
    assert "Licence: Apache-2.0\n\n--- mediapipe" in text
    assert "Licence: CC0-1.0" in text
    assert "handfit-core 0.1.0" not in text, "the project's own"


def test_the_same_text_stands_there_once(make_wheel, contents):
    names = [f"part-1.dist-info/licenses/{folder}/LICENSE" for folder in "abc"]
    wheel = make_wheel("part-1-py3-none-any.whl", files=dict.fromkeys(names, "A long text.\n"))
    changed = third_party_licences(type(contents)(**{**vars(contents), "wheels": ((wheel, ("3.11",)),)}))
    assert changed.count("A long text.") == 1
    assert all(f"--- {name} ---" in changed for name in names)
