"""Text blocks for what does not fit into one sentence: what went wrong, and on which system."""

from __future__ import annotations

import bpy

from ..common import installation

TEXT_NAME = "Hand Capture Details"


def write_details(title: str, sentence: str, why: Exception | str) -> bpy.types.Text:
    """Replace the text block Hand Capture Details: what was tried, what the interface said about it, the
    versions at play, and a traceback or the `details` of an error (a process's last words)."""
    details = why if isinstance(why, str) else getattr(why, "details", None) or ""
    parts = [title, "", sentence, "", installation.versions()]
    if details.strip():
        parts += ["", details.strip()]
    return write_text(TEXT_NAME, "\n".join(parts) + "\n")


def write_text(name: str, content: str) -> bpy.types.Text:
    """Return the text block of this name with this content; it is made if the file has none of its own."""
    text = local_text(name) or bpy.data.texts.new(name)
    text.clear()
    text.write(content)
    text.cursor_set(0)
    return text


def local_text(name: str) -> bpy.types.Text | None:
    """Return the file's own text block of this name, or None; a linked one of that name does not count."""
    return next((t for t in bpy.data.texts if t.name == name and t.library is None), None)
