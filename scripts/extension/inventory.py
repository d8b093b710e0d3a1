"""wheels.json: what the zip carries, read by the installed add-on to see whether all of it is there.

    {"schema": 1, "version": "0.1.0", "platform": "linux-x64", "pythons": ["3.11", "3.13"], "torch": "cpu",
     "wheels": [{"file": ..., "name": ..., "version": ..., "sha256": ..., "size": ..., "pythons": [...]}],
     "missing": [{"name": "torch", "python": "3.13", "why": "one sentence"}]}

Sizes in bytes; "pythons" of a wheel are those of the zip that can use it.
"""

from __future__ import annotations

import json

from scripts.extension.contents import Contents

FILE_NAME = "wheels.json"
SCHEMA = 1


def inventory(contents: Contents) -> str:
    """The file's text."""
    wheels = [
        {
            "file": wheel.path.name,
            "name": wheel.name,
            "version": wheel.version,
            "sha256": wheel.sha256,
            "size": wheel.size,
            "pythons": list(pythons),
        }
        for wheel, pythons in contents.wheels
    ]
    missing = [{"name": m.name, "python": m.python, "why": m.why} for m in contents.missing]
    return (
        json.dumps(
            {
                "schema": SCHEMA,
                "version": contents.version,
                "platform": contents.platform.name,
                "pythons": list(contents.pythons),
                "torch": contents.torch,
                "wheels": wheels,
                "missing": missing,
            },
            indent=2,
        )
        + "\n"
    )
