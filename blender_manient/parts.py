"""All parts of the add-on, in the order of their registration."""

from __future__ import annotations

from . import cache, error_graph, jobs, panels, preferences, properties, source_info
from .operators import (
    apply_take,
    capture,
    check_installation,
    check_mano,
    clear_cache,
    clear_corrections,
    copy_details,
    drop_media,
    edit_keypoints,
    export_hand,
    import_take,
    jump_doubtful,
    lock_joints,
    mark_doubtful,
    mirror_hand,
    move_keypoint,
    pose_asset,
    refit_range,
    relax_pose,
    reset_shape,
    select_hand,
    show_details,
    use_source,
)
from .scene import confidence, reshape
from .worker import shared

PARTS = (
    preferences,
    properties,
    cache,
    reshape,
    confidence,
    error_graph,
    import_take,
    export_hand,
    reset_shape,
    relax_pose,
    pose_asset,
    mirror_hand,
    apply_take,
    check_installation,
    check_mano,
    clear_cache,
    copy_details,
    show_details,
    shared,
    jobs,
    source_info,
    capture,
    use_source,
    drop_media,
    select_hand,
    mark_doubtful,
    jump_doubtful,
    clear_corrections,
    edit_keypoints,
    lock_joints,
    move_keypoint,
    refit_range,
    panels,
)
"""One line per part, so that changes stay small."""
