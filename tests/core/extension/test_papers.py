"""What a zip says of what it carries: licences, bill of materials, manifest."""

import json
import tomllib

import pytest

from handfit_core.detect.landmark_model import NETWORK_2020
from scripts.extension.papers import licence, sbom, third_party_licences
from scripts.extension.staging import MANIFEST, ROOT, staged_manifest
from scripts.extension.wheels import BuildError

GCC = "GPL-3.0-or-later WITH GCC-exception-3.1"


@pytest.mark.parametrize(
    ("file_name", "libraries", "expression"),
    [
        (
            "opencv_python_headless-4.11.0.86-cp37-abi3-macosx_13_0_arm64.whl",
            "cv2/.dylibs/libavcodec.61.19.100.dylib cv2/.dylibs/libx264.164.dylib cv2/libssl.3.dylib",
            "Apache-2.0 AND LGPL-2.1-or-later AND GPL-2.0-or-later",
        ),
        (
            "scipy-1.15.3-cp311-cp311-manylinux_2_28_x86_64.whl",
            "scipy.libs/libquadmath-1.so scipy.libs/libgfortran-1.so",
            f"BSD-3-Clause AND {GCC} AND LGPL-2.1-or-later",
        ),
        ("scipy-1.15.3-cp311-cp311-win_amd64.whl", "libscipy_openblas.dll", f"BSD-3-Clause AND {GCC}"),
    ],
)
def test_libraries_inside_a_wheel_bring_their_licences(make_wheel, file_name, libraries, expression):
    wheel = make_wheel(file_name, "License: Apache 2.0", files=dict.fromkeys(libraries.split(), ""))
    assert licence(wheel) == expression


def test_others_licences_and_texts_stand_in_the_file(wheels):
    text = third_party_licences(wheels)
    second = "MediaPipe hand landmark network of December 2020 0.1.1606863095"
    first = "MediaPipe hand landmark model 0.10.21", "MediaPipe body networks 0.10.21"
    bundled = *first, second, "Open hand 1"
    for heading in ("torch 2.13.0+cpu", "mediapipe 0.10.31", *bundled):
        assert text.count(f"\n{heading}\n{'=' * 100}\n") == 1
    assert "The licence of torch." in text
    assert "Licence: Apache-2.0\n\n--- mediapipe" in text
    assert "Licence: CC0-1.0" in text
    assert "handfit-core 0.1.0" not in text, "the project's own"


def test_every_part_is_a_component(wheels):
    found = json.loads(sbom("manient", "0.1.0", "linux-x64", wheels))
    components = {c["name"]: c for c in found["components"]}
    second = "MediaPipe hand landmark network of December 2020"
    bundled = {"MediaPipe hand landmark model", "MediaPipe body networks", second, "Open hand"}
    assert set(components) == {"torch", "mediapipe", "handfit-core", *bundled}
    assert components["torch"]["hashes"] == [{"alg": "SHA-256", "content": wheels[2].sha256}]
    assert components["torch"]["purl"].startswith("pkg:pypi/torch@2.13.0%2Bcpu?")
    assert components["torch"]["licenses"] == [{"expression": "MIT"}]
    assert components["mediapipe"]["licenses"] == [{"expression": "Apache-2.0"}]
    assert components[second]["licenses"] == [{"license": {"id": "Apache-2.0"}}]
    assert components[second]["version"] == NETWORK_2020.npm_version
    assert "purl" not in components["handfit-core"], "on an index that name could be somebody else's"
    references = {c["bom-ref"] for c in found["components"]}
    assert {ref for entry in found["dependencies"] for ref in entry["dependsOn"]} == references
    other = json.loads(sbom("manient", "0.2.0", "linux-x64", wheels))
    assert found["serialNumber"] != other["serialNumber"]


def test_the_bill_keeps_to_cyclonedx_schema(wheels):
    pytest.importorskip("cyclonedx", reason="cyclonedx-python-lib is not installed")
    pytest.importorskip("jsonschema", reason="jsonschema, which cyclonedx-python-lib needs, is not installed")
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    validator, text = JsonStrictValidator(SchemaVersion.V1_6), sbom("manient", "0.1.0", "linux-x64", wheels)
    assert validator.validate_str(text) is None
    assert validator.validate_str(text.replace('"library"', '"book"')) is not None


def test_the_manifest_is_for_one_platform_and_lists_the_wheels(wheels):
    text = (ROOT / MANIFEST).read_text(encoding="utf-8")
    before, after = tomllib.loads(text), tomllib.loads(staged_manifest(text, "linux-x64", wheels))
    assert after.pop("wheels") == [f"./wheels/{wheel.path.name}" for wheel in wheels]
    assert after.pop("platforms") == ["linux-x64"]
    before.pop("platforms")
    assert after == before
    for other in ('id = "x"\n[permissions]\n', 'platforms = [\n  "linux-x64",\n]\n'):
        with pytest.raises(BuildError, match="expected one line"):
            staged_manifest(other, "linux-x64", wheels)
