"""Proportions, poses and export from the panel's buttons."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from scenarios.capturing import capture, hands, pixels_of


def proportions(stage, source):
    """A slider that moves: the mesh follows while the main loop runs; one undo step puts all of it back."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    before, head = _mesh(armature), _knuckle(armature)
    for step in range(1, 11):
        armature.manient.betas[0] = 0.2 * step
        yield 0.03
    yield 1.0
    bpy.ops.ed.undo_push(message="Shape")
    moved = float(np.abs(_mesh(armature) - before).max())
    knuckle = float(np.abs(_knuckle(armature) - head).max())
    yield from stage.screenshot("proportions")
    yield from stage.undo()
    yield 1.0
    (armature,) = hands()
    return {
        "moved": moved,
        "knuckle": knuckle,
        "undone": float(np.abs(_mesh(armature) - before).max()),
        "betas": list(armature.manient.betas),
    }


def buttons(stage, source):
    """Relax, mirror, pose asset and export of a captured hand, each by its operator in the window."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    for operator in ("manient.apply_pose", "manient.mirror_hand", "manient.save_pose_asset"):
        yield from stage.invoke(operator)
        yield 0.5
    yield from stage.screenshot("pose-asset-dialog")
    yield from stage.key("RET")
    yield 0.5
    path = Path(source).with_name("exported.fbx")
    with stage.override():
        exported = bpy.ops.manient.export_hand(filepath=str(path), file_format="fbx")
    yield from stage.screenshot("shaped")
    return {
        "hands": sorted(armature.manient.side for armature in hands()),
        "assets": [action.name for action in bpy.data.actions if action.asset_data],
        "exported": [*exported, path.stat().st_size],
    }


def first_render(stage, source):
    """F12 after a first capture, in the engine that Blender starts with; then the same without a forearm."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    scene = bpy.context.scene
    scene.render.resolution_percentage = 50
    scene.eevee.taa_render_samples = 8
    shown = {}
    for name, forearm in (("forearm", True), ("cap", False)):
        armature.manient.forearm = forearm
        yield 0.5
        yield from stage.screenshot(f"wrist-{name}")
        path = stage.screenshots / f"f12-{name}.png"
        scene.render.filepath = str(path)
        with stage.override():
            bpy.ops.render.render(write_still=True)
        shown[name] = pixels_of(path)[..., :3]
    photo = pixels_of(Path(source))[..., :3]
    height, width = shown["cap"].shape[:2]
    rows, columns = (
        np.linspace(0, s - 1, n).astype(int) for s, n in zip(photo.shape, (height, width), strict=False)
    )
    off = np.abs(shown["cap"] - photo[np.ix_(rows, columns)]).mean(axis=-1)
    return {
        "engine": scene.render.engine,
        "lights": len([o for o in scene.objects if o.type == "LIGHT" and o.name != "Light"]),
        "like the photo": float((off < 0.05).mean()),
        "hand": float((off > 0.1).mean()),
        "forearm": float((np.abs(shown["forearm"] - shown["cap"]).mean(axis=-1) > 0.1).mean()),
    }


def _mesh(armature) -> np.ndarray:
    mesh = next(child for child in armature.children if child.type == "MESH").data
    points = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    return points


def _knuckle(armature) -> np.ndarray:
    return np.array(next(b for b in armature.data.bones if b.name.startswith("index_middle")).head_local)
