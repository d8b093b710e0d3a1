"""One exception tree. Every message says what was expected, what came, and what to do.

Anything below `HandfitError` is meant to be read by an artist: one sentence, no traceback.
Anything else that escapes is a defect of ours.
"""

from __future__ import annotations


class HandfitError(Exception):
    """Base of all errors that the user can do something about."""


class OptionError(HandfitError):
    """An option, name or range that does not exist; the message lists what does."""


class PictureSizeError(OptionError):
    """Another program's keypoints, of pictures whose size neither their file nor an option tells."""


class PlugInError(HandfitError):
    """A detector, solver or reader of another package failed; the message names both."""


class InputError(HandfitError):
    """A photo, sequence or video that is missing, empty, damaged or of an unknown kind."""


class NoHandFoundError(HandfitError):
    """The whole input was read and no hand was found in any of its frames."""


class LandmarkModelError(HandfitError):
    """MediaPipe's landmark model file is missing, damaged or could not be assembled."""


class HandModelError(HandfitError):
    """A hand model file that cannot be read, is unsafe, or does not have MANO's shape."""


class TakeError(HandfitError):
    """A take file that cannot be read: damaged, not a take, or written by a newer version."""


class DatasetError(HandfitError):
    """A labelled data set whose files are not where, or what, its layout says."""


class OutputError(HandfitError):
    """A result could not be written (folder not writable, disk full, name taken)."""


class ProtocolError(HandfitError):
    """A message between Blender and the worker that the other side cannot read."""


class Cancelled(HandfitError):
    """The user stopped the work before there was anything to keep."""


class BuildInterrupted(HandfitError):
    """Data-blocks vanished while hands were being built (an undo, another file): build again."""
