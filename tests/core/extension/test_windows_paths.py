from __future__ import annotations

import pytest

from scripts.extension.windows_paths import LIMIT, folder, longest_path, warning


def with_path_of(make_wheel, length):
    return make_wheel("part-1-py3-none-any.whl", files={"p/" + "x" * (length - 2): ""})


def test_the_longest_path_counts_blenders_folder_and_the_closing_null(make_wheel):
    wheel = with_path_of(make_wheel, 100)
    length, where, member = longest_path([make_wheel("other-1-py3-none-any.whl"), wheel], user="me")
    assert length == len(folder("me")) + 100 + 1
    assert (where, len(member)) == (wheel, 100)


@pytest.mark.parametrize(("too_long", "whom"), [(0, ""), (1, "users with long names"), (25, "every user")])
def test_a_warning_above_the_limit(make_wheel, too_long, whom):
    wheel = with_path_of(make_wheel, LIMIT - 1 - len(folder("u" * 20)) + too_long)
    sentence = warning([wheel])
    assert whom in sentence
    assert bool(sentence) == bool(too_long)
