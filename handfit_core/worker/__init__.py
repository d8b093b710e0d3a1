"""The process that Blender talks to: `python -m handfit_core worker` (docs/worker-protocol.md). A line of its
own end may import anything of the core; one of Blender's end (`client.py`) imports light modules only."""
