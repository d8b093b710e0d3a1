"""The user's measured lenses, kept by name in one file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.files import data_dir, read_file, shown, storable, why, written_whole
from handfit_core.common.values import number, whole
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens

LONGEST_NAME: Final = 60
NUMBERS: Final = re.compile(r"[\d.,eE+\s-]*")
"""What is no name of a lens: nothing, and numbers that the option `lens` takes for a lens themselves"""
_LARGEST: Final = 10_000_000
"""bytes, as of 40 000 lenses"""


@dataclass(frozen=True)
class MeasuredLens:
    """A lens, and how well it is known."""

    lens: Lens
    error: float
    """px, root mean square over the chessboard's corners"""
    focal_sigma: float
    """px, standard deviation of the focal length"""
    boards: int
    """How many were calibrated with"""

    @property
    def said(self) -> str:
        """What is told of it, a phrase."""
        lens, focal = self.lens, self.lens.intrinsics.fx
        view = math.degrees(2.0 * math.atan(max(lens.width, lens.height) / (2.0 * focal)))
        k1, k2 = lens.distortion[:2]
        return (
            f"focal length {focal:.1f} px, within {self.focal_sigma:.1f} px, in pictures of "
            f"{lens.width}x{lens.height} (a view of {view:.0f} degrees), distortion {k1:.3f} and {k2:.3f}; "
            f"corners of {self.boards} boards within {self.error:.2f} px"
        )


def lens_numbers(lens: Lens) -> dict[str, Any]:
    """A lens as JSON can hold it."""
    return {
        "width": lens.width,
        "height": lens.height,
        "intrinsics": list(vars(lens.intrinsics).values()),
        "distortion": list(lens.distortion),
    }


def lens_of_numbers(numbers: Mapping[str, Any]) -> Lens:
    """The lens that `lens_numbers` made these of. Raises ValueError."""
    try:
        distortion = tuple(number("distortion", term) for term in numbers["distortion"])
        intrinsics = Intrinsics(*(number("intrinsics", value) for value in numbers["intrinsics"]))
        sides = (whole(side, numbers[side]) for side in ("width", "height"))
        return Lens(intrinsics, distortion, *sides)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, OptionError) as error:
        raise ValueError(f"a lens with intrinsics, distortion, width and height ({error!r})") from None


def lenses_path() -> Path:
    """The file of the user's lenses."""
    return data_dir() / "lenses.json"


def saved_lenses() -> dict[str, MeasuredLens]:
    """The user's lenses by their names, in alphabetical order. Raises InputError for a damaged file."""
    path = lenses_path()
    try:
        content = json.loads(read_file(path, _LARGEST))
        return {name: _measured(one) for name, one in sorted(dict(content).items())}
    except FileNotFoundError:
        return {}
    except (OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        reason = why(error) if isinstance(error, OSError) else error
        raise InputError(
            f"{shown(path)}: the saved lenses cannot be read ({reason}); mend the file, or move it away and "
            "measure them again"
        ) from None


def saved_lens(name: str) -> MeasuredLens:
    """The user's lens of that name. Raises OptionError where there is none, and InputError."""
    lenses = saved_lenses()
    if name not in lenses:
        there = f"; saved are {', '.join(map(shown, lenses))}" if lenses else ", and none is saved"
        raise OptionError(
            f"there is no measured lens {shown(name)}{there}: measure it with the command lens, or with "
            "Measure Lens in Blender"
        )
    return lenses[name]


def checked_name(name: str) -> str:
    """A name as it is saved. Raises OptionError for one that cannot be told from numbers, or is too long."""
    name = storable(name).strip()
    if len(name) > LONGEST_NAME or NUMBERS.fullmatch(name):
        raise OptionError(
            f"give the lens a name with a letter and at most {LONGEST_NAME} signs, such as 'my phone'; got "
            f"{shown(name)}"
        )
    return name


def save_lens(name: str, measured: MeasuredLens | None) -> None:
    """Save a lens under a name, in place of one of that name; None: forget that. Raises OptionError,
    InputError and OutputError."""
    lenses = saved_lenses()
    if measured is None:
        saved_lens(name)
        del lenses[name]
    else:
        lenses[checked_name(name)] = measured
    kept = {
        name: lens_numbers(one.lens)
        | {"error": one.error, "focal_sigma": one.focal_sigma, "boards": one.boards}
        for name, one in lenses.items()
    }
    with written_whole(lenses_path()) as beside:
        beside.write_text(json.dumps(kept, indent=1), encoding="ascii")


def _measured(content: Mapping[str, Any]) -> MeasuredLens:
    error, sigma = (number(name, content[name], least=0.0) for name in ("error", "focal_sigma"))
    return MeasuredLens(lens_of_numbers(content), error, sigma, whole("boards", content["boards"]))
