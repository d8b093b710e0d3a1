"""What users can do in Blender, one operator per file."""
