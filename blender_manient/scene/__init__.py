"""What a take becomes in Blender, one builder per file."""
