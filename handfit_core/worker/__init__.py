"""The process that Blender talks to: `python -m handfit_core worker` (docs/worker-protocol.md)."""
