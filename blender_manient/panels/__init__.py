"""The sidebar tab "Hand Capture" in the 3D viewport, one section per file, in the order of `bl_order`."""
