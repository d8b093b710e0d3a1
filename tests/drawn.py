"""Sections and dialogs drawn where no window shows them: what they say, and which of it is grey."""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import bpy


class Page:
    """In the place of a layout, which background mode does not have: reads what a real one would read, and
    notes what it shows."""

    def __init__(self, within: Page | None = None) -> None:
        self.enabled, self.alert = True, False
        self._within = within
        self._shown: list[tuple[str, Page]] = [] if within is None else within._shown

    @property
    def said(self) -> str:
        """All texts, and the names of what has none, in a line: sentences are wrapped anywhere."""
        return " ".join(text for text, _ in self._shown if text)

    @property
    def rows(self) -> list[str]:
        """Each text for itself, and the names of what has none, in their order."""
        return [text for text, _ in self._shown]

    @property
    def loud(self) -> str:
        """What of it is red."""
        return " ".join(text for text, page in self._shown if page.alert)

    @property
    def grey(self) -> list[str]:
        """Those that cannot be used."""
        return [text for text, page in self._shown if not page._usable()]

    def prop(self, data: Any, name: str, *, text: str | None = None, **_: Any) -> None:
        getattr(data, name)
        self._shown.append((name if text is None else text, self))

    def prop_search(self, data: Any, name: str, among: Any, _field: str, *, text: str | None = None) -> None:
        assert among is not None
        self.prop(data, name, text=text)

    def prop_enum(self, _data: Any, _name: str, value: str) -> None:
        self._shown.append((value, self))

    def operator(self, name: str, *, text: str | None = None, **_: Any) -> SimpleNamespace:
        assert hasattr(bpy.ops, name.partition(".")[0])
        self._shown.append((name if text is None else text, self))
        return SimpleNamespace()

    def label(self, *, text: str = "", **_: Any) -> None:
        assert isinstance(text, str)
        self._shown.append((text, self))

    def __getattr__(self, _: str) -> Callable[..., Page]:
        return lambda *_, **__: Page(self)

    def _usable(self) -> bool:
        return self.enabled and (self._within is None or self._within._usable())


class _Shown:
    """In the place of a panel or an operator: its functions, the properties that it has, and our layout."""

    def __init__(self, cls: Any, properties: dict[str, Any]) -> None:
        self._cls, self.layout = cls, Page()
        vars(self).update(properties)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._cls, name)
        return functools.partial(found, self) if callable(found) else found


def drawn(cls: Any, **properties: Any) -> Page:
    """What a panel, or the dialog of an operator with these properties, shows now; empty where its poll says
    no."""
    shown = _Shown(cls, properties)
    if issubclass(cls, bpy.types.Operator) or not hasattr(cls, "poll") or cls.poll(bpy.context):
        cls.draw(shown, bpy.context)
    return shown.layout
