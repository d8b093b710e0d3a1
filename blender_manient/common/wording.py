"""Sentences and names as they are shown to people."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence

NAME_BYTES = 63
"""The most bytes that Blender has room for in a data-block's name; it cuts off the rest"""

LINE = 38
"""How many letters fit in a line of the sidebar, as wide as Blender makes it"""

_GAP = "..."
_NAME_OF_A_FILE = re.compile(r"[/\\]|\.\w{1,5}$")
"""What tells that the text before a sentence's first colon is the name of a file"""


def capitalised(sentence: str) -> str:
    """Return a sentence with a capital letter, except where it begins with the name of a file, which is
    written as it is."""
    head = sentence.partition(": ")[0] if ": " in sentence else sentence.partition(" ")[0]
    if _NAME_OF_A_FILE.search(head.rstrip(".,;")):
        return sentence
    return sentence[:1].upper() + sentence[1:]


def headline(text: str, most: int = LINE) -> str:
    """Return as much of a message as one line of the sidebar shows: its first sentence, cut behind a word."""
    first = text.partition(". ")[0]
    cut = textwrap.shorten(first, most, placeholder=_GAP)
    return cut if cut != _GAP else shortened(first, lambda part: len(part) <= most)


def counted(number: int, thing: str) -> str:
    """Return a number with the name of a thing, one or several: 1 frame, 2 frames."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def without_name(sentence: str, names: Sequence[str]) -> str:
    """Return the sentence without one of `names` and a colon at its beginning, for where the name is shown
    already."""
    for name in sorted(names, key=len, reverse=True):
        if name and sentence.startswith(f"{name}: "):
            return sentence[len(name) + 2 :]
    return sentence


def shortened(text: str, fits: Callable[[str], bool]) -> str:
    """Return the text, or as much of its beginning and its end as fits: names differ at their ends."""
    if fits(text):
        return text
    kept = 2
    while kept + 1 < len(text) and fits(_with_gap(text, kept + 1)):
        kept += 1
    return _with_gap(text, kept)


def shortened_name(text: str, most: int) -> str:
    """Return a name of at most `most` bytes in UTF-8, as Blender counts."""
    return shortened(text, lambda name: len(name.encode()) <= most)


def named_after(stem: str, part: str) -> str:
    """Return the name of one part of a capture, as "left hand of clip", with room for what is named after
    that, such as its mesh, and for the number with which Blender tells equal names apart."""
    return f"{part} of {shortened_name(stem, NAME_BYTES - len('mesh of right hand 99 of .001'))}"


def hand_part(side: str, others: int) -> str:
    """Return the name of a hand as a part of its capture, beside so many others of its side: "right hand
    2"."""
    return f"{side} hand {others + 1}" if others else f"{side} hand"


def with_note(name: str, note: str) -> str:
    """Return a name with a note that tells this one from its like, with room for the number that
    `named_after` leaves."""
    return f"{shortened_name(name, NAME_BYTES - len(f' {note}.001'.encode()))} {note}"


def _with_gap(text: str, kept: int) -> str:
    """Return the first and last letters of a text with a gap between them, `kept` of them in all."""
    return text[: kept // 2] + _GAP + text[len(text) - (kept - kept // 2) :]
