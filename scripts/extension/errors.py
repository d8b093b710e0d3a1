"""What keeps a zip from being built."""

from __future__ import annotations

from handfit_core.errors import HandfitError


class BuildError(HandfitError):
    """A zip that cannot be built: a wheel, lock or tool that is missing, or is not the one expected."""
