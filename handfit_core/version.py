"""The version of the core. A test holds it equal to blender_manifest.toml's."""

__version__ = "0.1.0"
