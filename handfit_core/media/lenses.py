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
"""Pattern of what is no name of a lens: nothing, and numbers that the option `lens` takes for a lens
themselves"""
_LARGEST: Final = 10_000_000
"""Most bytes of the file of lenses that are read, as of 40 000 lenses"""


@dataclass(frozen=True)
class MeasuredLens:
    """A lens that was measured with a chessboard, and how well it is known."""

    lens: Lens
    error: float
    """Root mean square distance, in pixels, of the chessboard's corners from where the lens puts them"""
    focal_sigma: float
    """Standard deviation of the focal length, in pixels"""
    boards: int
    """How many views of the chessboard the lens was calibrated with"""

    @property
    def said(self) -> str:
        """The lens and its accuracy as a phrase for people."""
        lens, focal = self.lens, self.lens.intrinsics.fx
        view = math.degrees(2.0 * math.atan(max(lens.width, lens.height) / (2.0 * focal)))
        k1, k2 = lens.distortion[:2]
        return (
            f"focal length {focal:.1f} px, within {self.focal_sigma:.1f} px, in pictures of "
            f"{lens.width}x{lens.height} (a view of {view:.0f} degrees), distortion {k1:.3f} and {k2:.3f}; "
            f"corners of {self.boards} boards within {self.error:.2f} px"
        )


def lens_numbers(lens: Lens) -> dict[str, Any]:
    """Return a lens as JSON can hold it: its numbers by their names."""
    return {
        "width": lens.width,
        "height": lens.height,
        "intrinsics": list(vars(lens.intrinsics).values()),
        "distortion": list(lens.distortion),
    }


def lens_of_numbers(numbers: Mapping[str, Any]) -> Lens:
    """Return the lens that `lens_numbers` made these numbers of. Raises ValueError where they are none."""
    try:
        distortion = tuple(number("distortion", term) for term in numbers["distortion"])
        intrinsics = Intrinsics(*(number("intrinsics", value) for value in numbers["intrinsics"]))
        sides = (whole(side, numbers[side]) for side in ("width", "height"))
        return Lens(intrinsics, distortion, *sides)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, OptionError) as error:
        raise ValueError(f"a lens with intrinsics, distortion, width and height ({error!r})") from None


def lenses_path() -> Path:
    """Return the path of the file of the user's lenses."""
    return data_dir() / "lenses.json"


def saved_lenses() -> dict[str, MeasuredLens]:
    """Return the user's lenses by their names, in alphabetical order. Raises InputError for a damaged
    file."""
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
    """Return the user's saved lens of that name. Raises OptionError where there is none, InputError where the
    file of lenses cannot be read."""
    lenses = saved_lenses()
    if name not in lenses:
        there = f"; saved are {', '.join(map(shown, lenses))}" if lenses else ", and none is saved"
        raise OptionError(
            f"there is no measured lens {shown(name)}{there}: measure it with the command lens, or with "
            "Measure Lens in Blender"
        )
    return lenses[name]


def checked_name(name: str) -> str:
    """Return a name in the form in which it is saved. Raises OptionError for a name that cannot be told from
    numbers, or is too long."""
    name = storable(name).strip()
    if len(name) > LONGEST_NAME or NUMBERS.fullmatch(name):
        raise OptionError(
            f"give the lens a name with a letter and at most {LONGEST_NAME} signs, such as 'my phone'; got "
            f"{shown(name)}"
        )
    return name


def save_lens(name: str, measured: MeasuredLens | None) -> None:
    """Save a lens under a name, in place of a lens of that name; None: forget the lens of that name. Raises
    OptionError for a name that cannot be used or, to forget, is not there; InputError where the file of
    lenses cannot be read; OutputError where it cannot be written."""
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
