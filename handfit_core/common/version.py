"""The version: blender_manifest.toml's, which is its only place."""

from __future__ import annotations

from pathlib import Path

_EXTENSION = "manient"
_DISTRIBUTION = "handfit-core"


def _version(package: Path) -> str:
    """The version of the handfit_core in the folder `package`, as in "0.1.0".

    A checkout has the manifest beside the package. An installed package has its wheel's metadata there,
    which came from the manifest when the wheel was built. "unknown" where neither is.
    """
    return _of_checkout(package.parent) or _of_installation(package.parent) or "unknown"


def _of_checkout(folder: Path) -> str:
    """Return the version of a checkout, from the manifest first: an egg-info that setuptools left there may
    be an old one."""
    import tomllib

    try:
        manifest = tomllib.loads((folder / "blender_manifest.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    return str(manifest.get("version", "")) if manifest.get("id") == _EXTENSION else ""


def _of_installation(folder: Path) -> str:
    """Return the version of an installed package, from the metadata beside it only: another Python path may
    hold another version."""
    from importlib import metadata

    found = metadata.distributions(name=_DISTRIBUTION, path=[str(folder)])
    return next((distribution.version for distribution in found), "")


__version__ = _version(Path(__file__).resolve().parents[1])
