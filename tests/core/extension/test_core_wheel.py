from __future__ import annotations

import shutil

import pytest

from scripts.extension.core_wheel import ROOT, refuse_licensed_models
from scripts.extension.errors import BuildError


@pytest.mark.parametrize("name", ["MANO_RIGHT.pkl", "mano_left.npz", "hand.pickle"])
def test_licensed_models_do_not_go_into_the_zip(tmp_path, name):
    shutil.copytree(ROOT / "handfit_core" / "hand_model", tmp_path / "hand_model")
    refuse_licensed_models(tmp_path)
    (tmp_path / "hand_model" / "data" / name).write_bytes(b"")
    with pytest.raises(BuildError, match=rf"handfit_core/hand_model/data/{name}: .*must not go into the zip"):
        refuse_licensed_models(tmp_path)
