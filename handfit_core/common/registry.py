"""Parts that anybody may add, found by name: detectors, solvers, readers.

A registry knows the parts that come with this package and those that installed packages offer as entry
points of its group, in their own pyproject.toml:

    [project.entry-points."handfit.detectors"]
    my-detector = "my_package.my_module:MY_DETECTOR"

A part is an object that says what it can do: whoever uses it asks for a capability, never for a name.
Nothing is imported before it is asked for. A plug-in that cannot be loaded is named in a warning and left
out, whatever is wrong with it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from handfit_core.common.errors import HandfitError, OptionError, PlugInError
from handfit_core.common.files import data_dir
from handfit_core.common.values import shortly

log = logging.getLogger("handfit")

Part = TypeVar("Part")


@dataclass(frozen=True)
class _UserFile:
    """A plug-in that is one Python file of the user's; it has the methods of an entry point."""

    name: str
    module: str
    """The path of the plug-in's file"""
    kind: type
    dist = None

    def load(self) -> Any:
        """Import the file and return its part, or what has a part as its `reader`, whatever its name in the
        file; None where there is none."""
        spec = importlib.util.spec_from_file_location(f"handfit_user_{self.name}", self.module)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
        every = [
            getattr(each, "reader", each) for each in vars(module).values() if not isinstance(each, type)
        ]
        return next((each for each in every if isinstance(each, self.kind)), None)


class Registry(Generic[Part]):
    """The parts of one kind, by name.

    `group` is the group of the entry points, `noun` what messages call such a part, `kind` the class that
    every part is an instance of, and `built_in` gives the place, as in "package.module:ATTRIBUTE", of each
    part of this package. `folder`: the name of a folder of the user's data whose Python files are plug-ins,
    too, each called as its file. A plug-in cannot take the name of a built-in part.
    """

    def __init__(
        self, group: str, noun: str, kind: type[Part], built_in: Mapping[str, str], folder: str = ""
    ) -> None:
        self._group, self._noun, self._kind, self._folder = group, noun, kind, folder
        self._built_in = {name: EntryPoint(name, place, group) for name, place in built_in.items()}
        self._parts: dict[str, Part] = {}
        self._failed: dict[str, str] = {}

    def offered(self) -> list[str]:
        """Return the names of all parts, for a list: nothing is loaded, and no warning tells what is
        wrong."""
        try:
            return list(dict.fromkeys([*self._built_in, *(point.name for point in self._plug_ins())]))
        except Exception:  # a package's metadata can be damaged in any way
            return list(self._built_in)

    def _plug_ins(self) -> list[EntryPoint | _UserFile]:
        files = sorted((data_dir() / self._folder).glob("*.py")) if self._folder else []
        own = [_UserFile(file.stem.replace("_", "-"), str(file), self._kind) for file in files]
        return [*own, *sorted(entry_points(group=self._group), key=lambda point: point.name)]

    @cached_property
    def _offered(self) -> dict[str, EntryPoint | _UserFile]:
        """Return every part's entry point by the part's name: built-in ones first, then plug-ins by their
        names."""
        offered: dict[str, EntryPoint | _UserFile] = {**self._built_in}
        try:
            plug_ins = self._plug_ins()
        except Exception as error:  # a package's metadata can be damaged in any way
            log.warning("plug-ins cannot be looked for, as a package's metadata is damaged (%s)", error)
            return offered
        for point in plug_ins:
            if offered.setdefault(point.name, point) != point:
                log.warning(
                    "the %s %s of %s is left out, as its name is taken",
                    self._noun,
                    point.name,
                    _origin(point),
                )
        return offered

    def names(self) -> tuple[str, ...]:
        """Return the names of all parts but those that are known to fail, built-in ones first."""
        return tuple(name for name in self._offered if name not in self._failed)

    def get(self, name: str) -> Part:
        """Return the part of that name. Raises OptionError where there is none, or where it cannot be
        loaded."""
        if name not in self._built_in and name not in self._offered:
            raise OptionError(
                f"there is no {self._noun} {shortly(name)}; choose one of {', '.join(self.names())}"
            )
        part = self._load(name)
        if part is None:
            raise OptionError(
                f"{self._failed[name]}; update or remove that package, or choose one of "
                f"{', '.join(self.names())}"
            )
        return part

    @contextlib.contextmanager
    def blamed(self, name: str) -> Iterator[None]:
        """Within, the part of that name is at work: what a plug-in raises that is no sentence of its own is
        raised as a PlugInError, which names it."""
        try:
            yield
        except (HandfitError, MemoryError):
            raise
        except Exception as error:
            if name in self._built_in:
                raise
            raise PlugInError(
                f"the {self._noun} {name} of {_origin(self._offered[name])} failed ({_said(error)}); "
                f"update or remove that package, or choose another {self._noun}"
            ) from error

    def built_in(self) -> dict[str, Part]:
        """Return the parts of this package by name; no plug-in is imported for them."""
        return {name: self.get(name) for name in self._built_in}

    def all(self) -> dict[str, Part]:
        """Return every part that can be loaded by name, built-in ones first."""
        parts = {name: self._load(name) for name in self._offered}
        return {name: part for name, part in parts.items() if part is not None}

    def _load(self, name: str) -> Part | None:
        """Return the part of that name, loaded once; None for a plug-in that cannot be loaded, which a
        warning has named."""
        if name in self._parts or name in self._failed:
            return self._parts.get(name)
        point = self._built_in.get(name) or self._offered[name]
        try:
            part = point.load()
            if not isinstance(part, self._kind):
                raise TypeError(f"it is a {type(part).__name__} and no {self._kind.__name__}")
        except (Exception, SystemExit) as error:  # whatever a stranger's module does while it is imported
            if name in self._built_in:
                raise
            self._failed[name] = (
                f"the {self._noun} {name} of {_origin(point)} cannot be loaded ({_said(error)})"
            )
            log.warning("%s and is left out", self._failed[name])
            return None
        self._parts[name] = part
        return part


def _origin(point: EntryPoint | _UserFile) -> str:
    """Return the package that offers a plug-in, or its module where no package says so."""
    return f"the package {point.dist.name}" if point.dist is not None else point.module


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
