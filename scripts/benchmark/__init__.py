"""The rendered benchmark: what `scripts/render_benchmark.py` draws, and how.

Everything random is decided in NumPy, without Blender: poses (`poses`, `reach`, `grasp`, `contact`),
where the camera stands (`views`), arms and props as meshes (`meshes`, `arm`), and whole
pictures and clips (`stills`, `clips`). Only `scene` and `materials` need bpy. Lengths are metres.
"""
