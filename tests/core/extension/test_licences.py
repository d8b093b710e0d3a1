from __future__ import annotations

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
    assert "Licence: Apache 2.0" in text
    assert "Licence: CC0-1.0" in text
    assert "handfit-core 0.1.0" not in text, "the project's own"


def test_the_same_text_stands_there_once(make_wheel, contents):
    names = [f"part-1.dist-info/licenses/{folder}/LICENSE" for folder in "abc"]
    wheel = make_wheel("part-1-py3-none-any.whl", files=dict.fromkeys(names, "A long text.\n"))
    changed = third_party_licences(type(contents)(**{**vars(contents), "wheels": ((wheel, ("3.11",)),)}))
    assert changed.count("A long text.") == 1
    assert all(f"--- {name} ---" in changed for name in names)
