from __future__ import annotations

import json

from scripts.extension.inventory import inventory


def test_the_inventory_names_every_wheel_and_what_is_missing(contents):
    found = json.loads(inventory(contents))
    wheels = found.pop("wheels")
    assert found == {
        "schema": 1,
        "version": "0.1.0",
        "platform": "linux-x64",
        "pythons": ["3.11", "3.13"],
        "torch": "cpu",
        "missing": [{"name": "torch", "python": "3.13", "why": "there is no CPU build"}],
    }
    assert [(w["name"], w["version"], w["pythons"]) for w in wheels] == [
        ("handfit-core", "0.1.0", ["3.11", "3.13"]),
        ("mediapipe", "0.10.31", ["3.11", "3.13"]),
        ("torch", "2.13.0+cpu", ["3.11"]),
    ]
    for entry, (wheel, _) in zip(wheels, contents.wheels, strict=True):
        assert (entry["file"], entry["sha256"], entry["size"]) == (wheel.path.name, wheel.sha256, wheel.size)
