"""A shot as a Blender scene: hands on arms, props, background, light, camera and render settings."""

from __future__ import annotations

from typing import Final

import bpy
import numpy as np
from mathutils import Matrix, Vector

from blender_manient.common.blender_versions import use_nodes
from blender_manient.scene.build import BuiltTake, build_take
from handfit_core.common.errors import OptionError
from handfit_core.hand_model import axes

from .materials import TINT, skin, surface
from .meshes import Mesh, ball, box
from .shots import Shot, ShotHand
from .tint import LUMINANCE, hand_tint, skin_tone
from .views import random_direction

SHUTTER: Final = 0.5
"""Share of a frame's time in which the shutter is open; the frame is the middle"""
_VIEW_TRANSFORMS: Final = ("Standard", "Standard", "Filmic", "AgX")


def build_scene(shot: Shot, samples: int) -> BuiltTake:
    """Replace the open file by the shot, ready to render; frame numbers are rows of the key frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rng = np.random.default_rng(shot.look_seed)
    built = build_take(shot.take(), picture=False, wrist="open", render_setup=False)
    scene = bpy.context.scene
    tone = skin_tone(rng)
    skin_material = skin(tone, rng)
    fabric = surface("fabric", rng, (10.0, 300.0))
    for hand, rig in zip(shot.hands, built.hands, strict=True):
        rig.mesh.data.materials.clear()
        rig.mesh.data.materials.append(skin_material)
        _tint(rig.mesh.data, hand_tint(hand, tone))
        _add_arm(hand, rig, skin_material, fabric)
    depth = _add_surroundings(shot, scene, rng)
    _light(scene, depth, tone, rng)
    _set_up_render(scene, shot, samples, depth, built, rng)
    return built


def add_mesh(name: str, mesh: Mesh, vertices: np.ndarray) -> bpy.types.Object:
    """An object with the mesh's polygons over `vertices` (V, 3), linked to the open scene."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(vertices.tolist(), [], [list(p) for p in mesh.polygons])
    data.polygons.foreach_set("use_smooth", np.full(len(mesh.polygons), mesh.smooth))
    data.update()
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made


def _tint(data: bpy.types.Mesh, colours: np.ndarray) -> None:
    layer = data.color_attributes.new(TINT, "FLOAT_COLOR", "POINT")
    rgba = np.ones((len(colours), 4), dtype=np.float32)
    rgba[:, :3] = colours
    layer.data.foreach_set("color", rgba.ravel())


def _add_arm(hand: ShotHand, rig, skin_material: bpy.types.Material, fabric: bpy.types.Material) -> None:
    """Forearm and sleeve, bound to the wrist."""
    materials = {"forearm": skin_material, "sleeve": fabric}
    for name, mesh in hand.arm_parts.items():
        made = add_mesh(f"{hand.side} {name}", mesh, axes.points_to_rest(mesh.vertices))
        made.data.materials.append(materials[name])
        _tint(made.data, np.ones((len(mesh.vertices), 3)))
        bone = rig.armature.data.bones[0].name
        made.vertex_groups.new(name=bone).add(list(range(len(mesh.vertices))), 1.0, "REPLACE")
        made.parent = rig.armature
        made.modifiers.new("Armature", "ARMATURE").object = rig.armature


def _add_surroundings(shot: Shot, scene: bpy.types.Scene, rng: np.random.Generator) -> float:
    """Props, a wall and things before it, all on one empty that moves as the shot says; returns the
    hands' mean depth in metres."""
    points = np.concatenate([hand.keypoints() for hand in shot.hands], axis=1)
    depth = float(points[..., 2].mean())
    farthest = float(points[..., 2].max())
    root = bpy.data.objects.new("surroundings", None)
    scene.collection.objects.link(root)
    things = [add_mesh("prop", prop, axes.points_to_world(prop.vertices)) for prop in shot.props]
    for thing in things:
        thing.data.materials.append(surface("prop", rng, (5.0, 120.0)))

    wall_at = farthest + rng.uniform(0.65, 2.4)
    half_width = 0.5 * shot.size / shot.camera.fx
    tilt = Matrix.Rotation(rng.uniform(-0.7, 0.7), 3, Vector(random_direction(rng).tolist()))
    side = 3.2 * wall_at * half_width + 1.0
    wall = box(np.array([side, side, 0.02]))
    turned = wall.vertices @ np.array(tilt).T
    things.append(add_mesh("wall", wall, axes.points_to_world(turned + np.array([0.0, 0.0, wall_at]))))
    things[-1].data.materials.append(surface("wall", rng, (0.7, 40.0)))

    for _ in range(int(rng.integers(0, 6))):
        at = farthest + rng.uniform(0.15, max(0.2, wall_at - farthest))
        size = rng.uniform(0.04, 0.25) * at
        mesh = ball(size / 2) if rng.random() < 0.4 else box(size * rng.uniform(0.4, 1.2, 3))
        turn = Matrix.Rotation(rng.uniform(0, 3), 3, Vector(random_direction(rng).tolist()))
        where = np.array([*(rng.uniform(-1.1, 1.1, 2) * half_width * at), at + size])
        thing = add_mesh("thing", mesh, axes.points_to_world(mesh.vertices @ np.array(turn).T + where))
        thing.data.materials.append(surface("thing", rng, (4.0, 80.0)))
        things.append(thing)
    for thing in things:
        thing.parent = root
    if shot.clip is not None:
        _animate(root, shot.surroundings)
    return depth


def _animate(root: bpy.types.Object, motion: np.ndarray) -> None:
    """Key (F, 4, 4) motions of the camera frame, one per frame from 0 on."""
    world = np.eye(4)
    world[:3, :3] = axes.WORLD_FROM_CAMERA
    root.rotation_mode = "QUATERNION"
    for frame, matrix in enumerate(world @ motion @ world.T):
        moved = Matrix(matrix.tolist())
        root.location, root.rotation_quaternion = moved.to_translation(), moved.to_quaternion()
        root.keyframe_insert("location", frame=frame)
        root.keyframe_insert("rotation_quaternion", frame=frame)


def _light(scene: bpy.types.Scene, depth: float, tone: np.ndarray, rng: np.random.Generator) -> None:
    """One to three lamps, the sky's light, and an exposure for what they yield on skin."""
    centre = np.array([0.0, 0.0, depth])
    total = 0.0
    for i in range(int(rng.integers(1, 4))):
        direction = random_direction(rng)
        # The strongest lamp stands on the camera's side; others may shine from the back.
        if i == 0 and direction[2] > -0.15:
            direction = (
                direction * np.array([1.0, 1.0, -1.0]) if direction[2] > 0.15 else np.array([0.0, -0.7, -0.7])
            )
        irradiance = rng.uniform(1.2, 3.2) if i == 0 else rng.uniform(0.15, 1.0)
        total += irradiance * (0.7 if direction[2] < 0 else 0.2)
        _lamp(scene, centre, direction / np.linalg.norm(direction), irradiance, rng)
    strength = rng.uniform(0.2, 0.8)
    total += np.pi * strength * 0.7
    world = bpy.data.worlds.new("sky")
    scene.world = world
    background = next(n for n in use_nodes(world).nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*rng.uniform(0.65, 1.0, 3).tolist(), 1.0)
    background.inputs["Strength"].default_value = strength

    scene.view_settings.view_transform = _VIEW_TRANSFORMS[rng.integers(len(_VIEW_TRANSFORMS))]
    # A camera's meter sees the skin and the grey of everything else.
    reflected = total / np.pi * (0.5 * float(tone @ LUMINANCE) + 0.5 * 0.2)
    scene.view_settings.exposure = float(np.clip(np.log2(rng.uniform(0.14, 0.28) / reflected), -2.5, 2.5))


def _lamp(
    scene: bpy.types.Scene,
    centre: np.ndarray,
    direction: np.ndarray,
    irradiance: float,
    rng: np.random.Generator,
) -> None:
    """An area lamp or a sun that gives this irradiance (W/m2) at the centre, camera frame."""
    distance = rng.uniform(0.7, 2.5)
    if rng.random() < 0.3:
        light = bpy.data.lights.new("sun", "SUN")
        light.energy = irradiance
        light.angle = rng.uniform(0.01, 0.4)
    else:
        light = bpy.data.lights.new("lamp", "AREA")
        light.size = rng.uniform(0.15, 1.2)
        light.energy = irradiance * np.pi * distance**2
    warm = rng.uniform(-1, 1)
    light.color = (
        (1.0, 1.0 - 0.12 * abs(warm), 1.0 - 0.35 * warm) if warm > 0 else (1.0 + 0.25 * warm, 1.0, 1.0)
    )
    lamp = bpy.data.objects.new("lamp", light)
    lamp.location = axes.points_to_world(centre + distance * direction)
    towards = Vector(axes.points_to_world(-direction).tolist())
    lamp.rotation_euler = towards.to_track_quat("-Z", "Y").to_euler()
    lamp.visible_camera = False
    scene.collection.objects.link(lamp)


def _set_up_render(
    scene: bpy.types.Scene, shot: Shot, samples: int, depth: float, built: BuiltTake, rng: np.random.Generator
) -> None:
    camera = built.camera.data
    if rng.random() < 0.4:
        camera.dof.use_dof = True
        camera.dof.focus_distance = depth
        # An aperture that blurs the hand's own depth by a pixel or two at most.
        camera.dof.aperture_fstop = max(2.0, 0.5 * camera.lens**2 / (1000 * depth * rng.uniform(0.6, 2.0)))
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGB"
    render.image_settings.compression = 0
    render.use_compositing = False
    render.use_sequencer = False
    render.dither_intensity = 0.0
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.seed = int(rng.integers(2**31 - 1))
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = True
    try:
        cycles.denoiser = "OPENIMAGEDENOISE"
    except TypeError as error:
        raise OptionError(
            "this Blender is built without OpenImageDenoise, which the pictures need; take one from "
            "blender.org, or the bpy wheel"
        ) from error
    cycles.denoising_prefilter = "FAST"
    cycles.denoising_quality = "FAST"
    cycles.max_bounces = 2
    cycles.diffuse_bounces = 2
    cycles.glossy_bounces = 1
    cycles.caustics_reflective = cycles.caustics_refractive = False
    if shot.clip is not None:
        render.use_motion_blur = True
        render.motion_blur_shutter = SHUTTER + shot.readout
        if shot.readout > 0.0:
            cycles.rolling_shutter_type = "TOP"
            cycles.rolling_shutter_duration = SHUTTER / (SHUTTER + shot.readout)
        render.motion_blur_position = "CENTER"
        render.use_persistent_data = True
