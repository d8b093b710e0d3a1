from __future__ import annotations

import os
import zipfile

from scripts.extension.archive import fix


def test_order_times_and_modes_do_not_matter(tmp_path):
    content = {"b.py": b"b" * 1000, "a.py": b"a", "wheels/x.whl": b"wheel" * 1000}
    fixed = []
    for number, names in enumerate((["b.py", "a.py", "wheels/x.whl"], ["wheels/x.whl", "a.py", "b.py"])):
        folder = tmp_path / str(number)
        (folder / "wheels").mkdir(parents=True)
        with zipfile.ZipFile(folder / "made.zip", "w") as archive:
            for name in names:
                (folder / name).write_bytes(content[name])
                (folder / name).chmod(0o600 if number else 0o755)
                os.utime(folder / name, (1e9 + 1e6 * number,) * 2)
                kind = zipfile.ZIP_STORED if name.endswith(".whl") else zipfile.ZIP_DEFLATED
                archive.write(folder / name, name, kind)
        fix(folder / "made.zip")
        fixed.append(folder / "made.zip")
    assert fixed[0].read_bytes() == fixed[1].read_bytes()
    with zipfile.ZipFile(fixed[0]) as archive:
        assert archive.testzip() is None
        assert {name: archive.read(name) for name in archive.namelist()} == content
        # Compressed bytes would depend on the zlib of the Python at work.
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}
    assert [path.name for path in fixed[0].parent.glob("*.zip")] == ["made.zip"]
