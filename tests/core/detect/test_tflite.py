"""The metadata as MediaPipe's own schema reads it, and all that was in the file before."""

import numpy as np
import pytest

from handfit_core.detect.landmark_model import landmarks_2020_path
from handfit_core.detect.tflite import with_image_metadata

mp = pytest.importorskip("mediapipe")
schema = pytest.importorskip("mediapipe.tasks.metadata.schema_py_generated")
metadata_schema = pytest.importorskip("mediapipe.tasks.metadata.metadata_schema_py_generated")
flatbuffers = pytest.importorskip("flatbuffers")


def network() -> bytes:
    """A model file with one buffer of weights, written by the flatbuffers package."""
    model = schema.ModelT()
    model.version = 3
    model.description = "a network"
    model.operatorCodes, model.subgraphs = [], [schema.SubGraphT()]
    model.subgraphs[0].name = "main"
    model.buffers = [schema.BufferT(), schema.BufferT()]
    model.buffers[1].data = list(range(40))
    builder = flatbuffers.Builder(0)
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def test_what_was_in_the_file_stays_and_the_metadata_can_be_read():
    old = network()
    made = with_image_metadata(old, 127.5, 2.5, ("points", "é"))
    assert made == with_image_metadata(old, 127.5, 2.5, ("points", "é"))
    assert made[4:8] == b"TFL3"
    assert made.endswith(old)
    assert (len(made) - len(old)) % 16 == 0

    model = schema.ModelT.InitFromPackedBuf(made, 0)
    assert (model.version, model.description, model.subgraphs[0].name) == (3, b"a network", b"main")
    assert [None if b.data is None else list(b.data) for b in model.buffers[:2]] == [None, list(range(40))]
    (entry,) = model.metadata
    assert entry.name == b"TFLITE_METADATA"
    data = bytes(model.buffers[entry.buffer].data)
    assert data[4:8] == b"M001"

    (graph,) = metadata_schema.ModelMetadataT.InitFromPackedBuf(data, 0).subgraphMetadata
    (image,) = graph.inputTensorMetadata
    (unit,) = image.processUnits
    assert (list(unit.options.mean), list(unit.options.std)) == ([127.5], [2.5])
    assert image.content.contentProperties.colorSpace == metadata_schema.ColorSpaceType.RGB
    assert [output.name.decode() for output in graph.outputTensorMetadata] == ["points", "é"]
    features = {type(output.content.contentProperties) for output in graph.outputTensorMetadata}
    assert features == {metadata_schema.FeaturePropertiesT}


def test_mediapipe_runs_the_network_of_2020():
    path = landmarks_2020_path()
    if path is None:
        pytest.skip("MediaPipe's landmark network of December 2020 is not here")
    vision = mp.tasks.vision
    options = vision.ImageEmbedderOptions(mp.tasks.BaseOptions(model_asset_buffer=path.read_bytes()))
    with vision.ImageEmbedder.create_from_options(options) as network:
        picture = mp.Image(image_format=mp.ImageFormat.SRGB, data=np.zeros((224, 224, 3), np.uint8))
        outputs = network.embed(picture).embeddings
    assert [(o.head_name, len(o.embedding)) for o in outputs] == [
        *(("landmarks", 63), ("presence", 1), ("handedness", 1))
    ]
    assert 0.0 <= outputs[1].embedding[0] < 0.01
