"""Sections and dialogs drawn where no window shows them: what they say, and which of it is grey."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import bpy


@dataclass
class _Line:
    text: str
    """Of a message all of it, which is its tooltip"""
    seen: str
    page: Page


class Page:
    """In the place of a layout, which background mode does not have: reads what a real one would read, and
    notes what it shows."""

    def __init__(self, within: Page | None = None) -> None:
        self.enabled, self.alert = True, False
        self._within = within
        self._shown: list[_Line] = [] if within is None else within._shown

    @property
    def said(self) -> str:
        """All texts, those of messages whole, and the names of what has none."""
        return " ".join(line.text for line in self._shown if line.text)

    @property
    def rows(self) -> list[str]:
        """Each text for itself, and the names of what has none, in their order."""
        return [line.text for line in self._shown]

    @property
    def seen(self) -> list[str]:
        """Each line as an artist reads it: of a message what one line shows of it."""
        return [line.seen for line in self._shown]

    def words_before(self, text: str) -> int:
        """The number of words above the line that says just this."""
        return len(" ".join(self.seen[: self.seen.index(text)]).split())

    @property
    def loud(self) -> str:
        """What of it is red."""
        return " ".join(line.text for line in self._shown if line.page.alert)

    @property
    def grey(self) -> list[str]:
        """Those that cannot be used."""
        return [line.text for line in self._shown if not line.page._usable()]

    def prop(self, data: Any, name: str, *, text: str | None = None, **_: Any) -> None:
        value, of = getattr(data, name), data.bl_rna.properties.get(name)
        seen = [text] if text is not None else [of.name] if of is not None else [name]
        if isinstance(value, str) and value:
            items = getattr(of, "enum_items", {})
            seen.append(items[value].name if value in items else value)
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            seen.append(str(value))
        self._show(name if text is None else text, " ".join(seen))

    def prop_search(self, data: Any, name: str, among: Any, _field: str, *, text: str | None = None) -> None:
        assert among is not None
        self.prop(data, name, text=text)

    def prop_enum(self, data: Any, name: str, value: str) -> None:
        self._show(value, data.bl_rna.properties[name].enum_items[value].name)

    def operator(self, name: str, *, text: str | None = None, **_: Any) -> SimpleNamespace:
        assert hasattr(bpy.ops, name.partition(".")[0])
        module, _, function = name.partition(".")
        title = getattr(getattr(bpy.ops, module), function).get_rna_type().name
        line = self._show(name if text is None else text, title if text is None else text)
        if name == "manient.note":
            return cast(SimpleNamespace, line)
        return SimpleNamespace()

    def label(self, *, text: str = "", **_: Any) -> None:
        assert isinstance(text, str)
        self._show(text, text)

    def progress(self, *, text: str, **_: Any) -> None:
        self._show(text, text)

    def _show(self, text: str, seen: str) -> _Line:
        self._shown.append(_Line(text, seen, self))
        return self._shown[-1]

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
        is_method = inspect.isfunction(inspect.getattr_static(self._cls, name))
        return functools.partial(found, self) if is_method else found


def drawn(cls: Any, **properties: Any) -> Page:
    """What a panel, or the dialog of an operator with these properties, shows now; empty where its poll says
    no."""
    shown = _Shown(cls, properties)
    if issubclass(cls, bpy.types.Operator) or not hasattr(cls, "poll") or cls.poll(bpy.context):
        cls.draw(shown, bpy.context)
    return shown.layout
