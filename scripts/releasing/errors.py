"""Why something cannot be released."""

from __future__ import annotations


class ReleaseError(Exception):
    """One sentence: what is wrong and what to do."""
