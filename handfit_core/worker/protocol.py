"""The messages between Blender and its worker: JSON lines, with arrays packed into them by `arrays`.

docs/worker-protocol.md lists them. Both sides are of one version, which the first message tells, and believe
each other from then on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from handfit_core.errors import ProtocolError


def encode(message: Mapping[str, Any]) -> bytes:
    """One message -> one line, its end included.

    Plain ASCII: whatever a file is called, the line is valid UTF-8 and comes back as it was. Raises
    ProtocolError for what JSON cannot hold: NaN outside a packed array, and objects.
    """
    try:
        return json.dumps(message, allow_nan=False, separators=(",", ":")).encode("ascii") + b"\n"
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"a message must hold JSON's types only ({error}); pack arrays") from error
