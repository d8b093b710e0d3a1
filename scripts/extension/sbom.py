"""The software bill of materials, in CycloneDX 1.6 (JSON).

Written without a library, so that nothing needs to be installed; a test holds it against CycloneDX's schema.
It has no time, and a serial number made from its content: same input, same bytes.
"""

from __future__ import annotations

import json
import uuid
from typing import Any

from scripts.extension.contents import Contents
from scripts.extension.licences import BUNDLED, CORE, Bundled, is_expression, licence_name
from scripts.extension.wheel_file import WheelFile

FILE_NAME = "sbom.cdx.json"


def sbom(contents: Contents) -> str:
    """The file's text."""
    name = f"{contents.identity}@{contents.version}"
    parts = [_wheel(wheel) for wheel, _ in contents.wheels]
    core = next((part["bom-ref"] for part in parts if part["name"] == CORE), None)
    bundled = [_bundled(part) for part in BUNDLED] if core else []
    document: dict[str, Any] = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": name,
                "name": contents.identity,
                "version": contents.version,
                "licenses": [{"license": {"id": "GPL-3.0-or-later"}}],
                "properties": [
                    {"name": "manient:platform", "value": contents.platform.name},
                    {"name": "manient:pythons", "value": " ".join(contents.pythons)},
                ],
            }
        },
        "components": parts + bundled,
        "dependencies": [
            {"ref": name, "dependsOn": [part["bom-ref"] for part in parts]},
            *([{"ref": core, "dependsOn": [part["bom-ref"] for part in bundled]}] if core else []),
        ],
    }
    content = json.dumps(document, sort_keys=True)
    document["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_OID, content).urn
    return json.dumps(document, indent=2) + "\n"


def _wheel(wheel: WheelFile) -> dict[str, Any]:
    named = licence_name(wheel)
    version, file = (text.replace("+", "%2B") for text in (wheel.version, wheel.path.name))
    licence = {"expression": named} if is_expression(wheel) else {"license": {"name": named}}
    # handfit_core is on no index, and somebody else could take its name there.
    purl = {} if wheel.name == CORE else {"purl": f"pkg:pypi/{wheel.name}@{version}?file_name={file}"}
    return {
        "type": "library",
        "bom-ref": wheel.path.name,
        "name": wheel.name,
        "version": wheel.version,
        **purl,
        "hashes": [{"alg": "SHA-256", "content": wheel.sha256}],
        "licenses": [licence],
    }


def _bundled(part: Bundled) -> dict[str, Any]:
    return {
        "type": "data",
        "bom-ref": part.name.lower().replace(" ", "-"),
        "name": part.name,
        "version": part.version,
        "licenses": [{"license": {"id": part.licence}}],
    }
