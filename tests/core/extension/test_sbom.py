from __future__ import annotations

import dataclasses
import json

import pytest

from scripts.extension.sbom import sbom


def test_every_part_is_a_component(contents):
    found = json.loads(sbom(contents))
    components = {c["name"]: c for c in found["components"]}
    assert set(components) == {
        "torch",
        "mediapipe",
        "handfit-core",
        "MediaPipe hand landmark model",
        "Open hand",
    }
    torch = next(wheel for wheel, _ in contents.wheels if wheel.name == "torch")
    assert components["torch"]["hashes"] == [{"alg": "SHA-256", "content": torch.sha256}]
    assert components["torch"]["purl"].startswith("pkg:pypi/torch@2.13.0%2Bcpu?")
    assert components["torch"]["licenses"] == [{"expression": "MIT"}]
    assert components["mediapipe"]["licenses"] == [{"expression": "Apache-2.0"}]
    assert "purl" not in components["handfit-core"], "on an index that name could be somebody else's"
    references = {c["bom-ref"] for c in found["components"]}
    assert {ref for entry in found["dependencies"] for ref in entry["dependsOn"]} == references


def test_the_same_contents_give_the_same_text_and_others_another(contents):
    other = dataclasses.replace(contents, version="0.2.0")
    assert sbom(contents) == sbom(contents)
    assert json.loads(sbom(contents))["serialNumber"] != json.loads(sbom(other))["serialNumber"]


def test_it_keeps_to_cyclonedx_schema(contents):
    pytest.importorskip("cyclonedx", reason="cyclonedx-python-lib is not installed")
    pytest.importorskip("jsonschema", reason="jsonschema, which cyclonedx-python-lib needs, is not installed")
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    validator = JsonStrictValidator(SchemaVersion.V1_6)
    assert validator.validate_str(sbom(contents)) is None
    assert validator.validate_str(sbom(contents).replace('"library"', '"book"')) is not None
