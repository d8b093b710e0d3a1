"""What every other folder may ask for: Blender's versions, screen, preferences, plug-ins, sentences. A line
here knows nothing of hands. The package itself can be imported without Blender and without handfit_core."""
