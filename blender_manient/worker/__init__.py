"""The process that captures, as Blender sees it: one child that is started on first use and kept warm."""
