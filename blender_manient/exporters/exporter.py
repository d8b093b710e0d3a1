"""What a file format is to everything else, and what several of them share."""

from __future__ import annotations

import mmap
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal, Protocol

import bpy
import numpy as np

from handfit_core.common.skeleton import Side

from ..common.blender_versions import has_operator

APART = 2e-4
"""Metres by which bones that do not touch lie apart for Blender's importers"""


class HandObjects(Protocol):
    """A hand to write to a file, or a whole character."""

    @property
    def side(self) -> Side | None:
        """Return left or right; None for a character."""
        ...

    @property
    def armature(self) -> bpy.types.Object:
        """Return the armature that is written."""
        ...

    @property
    def meshes(self) -> Sequence[bpy.types.Object]:
        """Return the meshes that the armature deforms, none where the artist deleted a hand's, and what else
        is written with it."""
        ...


@dataclass(frozen=True)
class Preset:
    """The demands of one program on one format."""

    keywords: dict[str, Any] = field(default_factory=dict)
    """Arguments of Blender's exporter that replace those of the format"""
    clean: bool = True
    """True if the rig is written as `clean_rig` makes it"""
    units: float = 1.0
    """How many units of the file a metre is"""
    turn: np.ndarray | None = None
    """(3, 3) the rotation by which the data is turned, so that the objects need not be; None for none"""
    root: str = ""
    """The name of the armature object in the file; empty: as in Blender"""


class Exporter(ABC):
    """One file format. A class in a file of this folder is all that adds one."""

    name: ClassVar[str]
    """The name of the format on the command line and in scripts"""
    label: ClassVar[str]
    """The text of the format's button"""
    description: ClassVar[str]
    """The text of the button's tooltip"""
    suffix: ClassVar[str]
    writes: ClassVar[Literal["hands", "collection", "captured"]] = "hands"
    """The kind of input that the format wants: a scene with nothing but the hands; the whole collection with
    its camera, as a batch has it; or hands that keep their take, as the panel has them"""
    operator: ClassVar[str] = ""
    """The Blender operator that it needs, as module.name; empty for none"""
    bakes: ClassVar[bool] = True
    """True if a character is given as its deforming bones with a key on every frame, in metres; else as it is
    in the artist's file"""
    per_hand: ClassVar[bool] = False
    """True if each hand needs a file of its own"""
    presets: ClassVar[Mapping[str, Preset]] = {}
    """By UNITY and UNREAL, what differs from PLAIN for that program"""
    kept_endings: ClassVar[tuple[str, ...]] = ()
    """Endings of a name that stay instead of the suffix"""
    other_endings: ClassVar[tuple[str, ...]] = ()
    """Endings of a name that the suffix replaces"""
    apart: ClassVar[float] = 0.0
    """metres by which a bone that moves from its rest place is put beside the end of the one above: Blender's
    importer connects bones that touch, and leaves out where connected ones go"""
    reads: ClassVar[Mapping[str, Sequence[str]]] = {}
    """Endings of files that can be imported, each with the Blender operators that do it, the preferred one
    first"""
    of_scene: ClassVar[Mapping[str, Any] | None] = None
    """Arguments of Blender's exporter where the whole scene is written as it was imported; None: it is not"""

    @abstractmethod
    def write(self, path: Path, hands: Sequence[HandObjects], preset: Preset, final: Path, /) -> None:
        """Write the file to `path`, which is renamed to `final` once it is there. What the format `writes` is
        in the context's scene, at its frame range and rate, in metres and Blender's axes."""

    def is_whole(self, _stream: BinaryIO, _size: int, /) -> bool:
        """True if a file of `size` bytes, more than 0, was written to its end. Writers that say nothing of a
        full disk, as some of Blender's own, need it; what Python writes raises OSError. It may raise
        struct.error, ValueError, IndexError and OSError where the file is too short."""
        return True

    def missing(self, _path: Path, _bones: Sequence[str], /) -> str:
        """Return what of the motion of these bones a file that was written does not hold, as part of a
        sentence; empty where it holds it, or where that is not looked at."""
        return ""

    def read(self, path: Path, operator: str, /) -> set[str]:
        """Import a file into the open scene by an operator of `reads`; return the operator's result. Raises
        RuntimeError."""
        raise NotImplementedError

    def why_not(self) -> str:
        """Return why this Blender cannot write the format, and what to do, as part of a sentence; empty if it
        can."""
        return why_missing(self.operator) if self.operator else ""


def why_missing(operator: str) -> str:
    """Return why this Blender lacks an operator, and what to do, as part of a sentence; empty if it does
    not."""
    if has_operator(operator):
        return ""
    if operator.startswith("wm."):
        return "missing in this build of Blender; take the one from blender.org"
    return "switched off with its add-on; enable that in Blender's preferences"


def blank(path: Path, folder: Path) -> None:
    """Put ./././ in place of a folder's name in a file, which stays as long as it is."""
    name = os.fsencode(f"{folder}{os.sep}")
    if len(name) < 5:  # so near to the root it tells nothing, and may stand among numbers by chance
        return
    with path.open("rb+") as stream, mmap.mmap(stream.fileno(), 0) as content:
        place = content.find(name)
        while place >= 0:
            content[place : place + len(name)] = (b"./" * len(name))[: len(name) - 1] + b"/"
            place = content.find(name, place + len(name))
