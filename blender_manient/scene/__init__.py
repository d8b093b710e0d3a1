"""What a take becomes in Blender, one builder per file. A line here runs in Blender and changes its data, by
rigs alone: it knows of no file format, no operator and nothing that is drawn in a panel."""
