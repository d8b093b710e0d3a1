"""The table of programs and data sets that keep MANO's parameters: trackers, bodies and data sets, read by
`mano_files`."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from handfit_core.interchange.mano_files import ManoLayout

HAMER: Final = ManoLayout(
    "hamer",
    "HaMeR or WiLoR",
    "global_orient and hand_pose as matrices with right and pred_cam_t_full, in an .npz, JSON, .npy or "
    "pickle, or a folder of these with the frame's number in the names",
    "https://github.com/geopavlakos/hamer/blob/main/demo.py",
    # Not pred_cam_t, which is HaMeR's for the crop alone, nor focal_length: 5000 pixels of any picture
    "global_orient hand_pose betas right=right|is_right transl=pred_cam_t_full|cam_t_full|cam_t "
    "frame=frame|frames|frame_id|frame_ids|frame_idx focal=scaled_focal_length|focal_px "
    "size=img_size|image_size fps",
    needs="global_orient hand_pose right",
    nested="pred_mano_params mano_params wilor_preds mano camera",
    files=".*",
    matrices=True,
    mirrored="hands",
    assumed=("left hands were taken as the right ones of a mirrored crop, as HaMeR's and WiLoR's are",),
    assumes="left hands mirrored, no mean; the networks' focal length",
    mirrored_by="if they look so, read them with --reader wilor-mini",
)
WILOR_MINI: Final = replace(
    HAMER,
    name="wilor-mini",
    title="WiLoR-mini",
    phrase="lists of hands with is_right and wilor_preds, axis-angle, in JSON, .npz, .npy or a pickle, or a "
    "folder of these with the frame's number in the names",
    source="https://github.com/warmshao/WiLoR-mini",
    matrices=False,
    mirrored="no",
    assumed=("left hands were taken as left ones already, as WiLoR-mini's are",),
    assumes="no mirror, no mean",
    mirrored_by="if they look so, read them with --reader hamer",
)

HAWOR: Final = ManoLayout(
    "hawor",
    "HaWoR",
    "a clip's folder with cam_space/0 (left) and cam_space/1 (right), or world_space_res as an .npz with "
    "trans, rot, hand_pose, betas and valid",
    "https://github.com/ThunderVVV/HaWoR/blob/main/scripts/scripts_test_video/hawor_video.py",
    "global_orient=init_root_orient hand_pose=init_hand_pose transl=init_trans betas=init_betas",
    needs="global_orient hand_pose transl betas",
    folder="cam_space",
    sides={"0": "left", "1": "right"},
    files=r"(?P<frame>\d{1,9})_\d{1,9}",
    first_frame=1,
    assumed=("frames count from 1, where HaWoR counts them from 0",),
    assumes="no mirror, no mean; frames from 1",
    mirrored_by="it may be a right hand's",
    also=(
        ManoLayout(
            source="https://github.com/ThunderVVV/HaWoR/blob/main/scripts/scripts_test_video/hawor_slam.py",
            keys="global_orient=rot|pred_rot hand_pose=hand_pose|pred_hand_pose transl=trans|pred_trans "
            "betas=betas|pred_betas present=valid|pred_valid",
            needs="global_orient hand_pose transl present",
            rows="tracks",
            listed="trans rot hand_pose betas valid",
            assumed=("its world was taken to have the camera's axes, as in HaWoR's first frame",),
        ),
    ),
)
DYN_HAMR: Final = ManoLayout(
    "dyn-hamr",
    "Dyn-HaMR",
    "an .npz (*_world_results.npz) with trans, root_orient, pose_body and is_right",
    "https://github.com/ZhengdiYu/Dyn-HaMR/blob/main/dyn-hamr/optim/output.py",
    "global_orient=root_orient hand_pose=pose_body|latent_pose transl=trans betas right=is_right "
    "cam_R cam_t intrinsics=intrins",
    needs="global_orient hand_pose transl right",
    rows="tracks",
    mirrored="world",
    assumes="left hands mirrored with their places",
    mirrored_by="its is_right may be wrong",
)

_TURNS: Final = {"global_orient": slice(3), "hand_pose": slice(3, 48)}
_RATE: Final = "fps=mocap_frame_rate|mocap_framerate|fps|frame_rate|framerate"


def _body(left: int) -> dict[str, slice]:
    """Return the columns of the values of a body whose left hand's begin at column `left`."""
    hands = {"left_hand_pose": slice(left, left + 45), "right_hand_pose": slice(left + 45, left + 90)}
    return {"global_orient": slice(3), "body_pose": slice(3, 66), **hands}


SMPLX: Final = ManoLayout(
    "smplx",
    "SMPL-X or SMPL+H",
    "an .npz with poses of 165 or 156 numbers a frame, trans and mocap_frame_rate (AMASS, BEDLAM, BEAT2), or "
    "Motion-X's .npy of 322",
    "https://github.com/nghorbani/amass/blob/master/notebooks/01-AMASS_Visualization.ipynb",
    # `trans` is the body's; fingers alone tell nothing of where a hand is.
    f"body=trans present=hands_present model {_RATE}",
    needs="body_pose SIDE_hand_pose body|fps",
    met="two samples of AMASS (2026-11)",
    rows="sides",
    columns={"poses": {156: _body(66), 165: _body(75)}},
    # BEAT2's files are posed with a model that adds the mean; all others' with one that does not.
    mean_model="smplx2020",
    assumes="no mean, but BEAT2's; up as the body stands; no places",
    also=(
        ManoLayout(
            source="https://amass.is.tue.mpg.de",
            keys=f"global_orient=root_orient body_pose=pose_body {_RATE}",
            needs="global_orient body_pose SIDE_hand_pose",
            rows="sides",
            columns={"pose_hand": {90: {"left_hand_pose": slice(45), "right_hand_pose": slice(45, 90)}}},
        ),
        ManoLayout(
            source="https://github.com/IDEA-Research/Motion-X/blob/main/README.md",
            needs="body_pose SIDE_hand_pose",
            rows="sides",
            columns={"": {322: _body(66)}},
        ),
    ),
)
_BODIES: Final = ManoLayout(
    source="https://github.com/zc-alexfan/arctic/blob/master/docs/data/data_doc.md",
    keys=f"global_orient body_pose SIDE_hand_pose SIDE_present=SIDE_hand_valid {_RATE}",
    needs="global_orient body_pose SIDE_hand_pose",
    rows="sides",
)
SMPLX_KEYWORDS: Final = ManoLayout(
    "smplx-keywords",
    "smplx's parameters",
    "left_hand_pose and right_hand_pose with global_orient and body_pose (SMPLer-X's folder smplx, ARCTIC's "
    ".smplx.npy), or hands as this program writes them",
    "https://github.com/vchoutas/smplx/blob/main/smplx/body_models.py",
    "SIDE_global_orient SIDE_hand_pose SIDE_transl SIDE_betas SIDE_present fps frame=frame_numbers "
    "size=picture_size intrinsics",
    needs="SIDE_global_orient SIDE_hand_pose",
    rows="sides",
    assumes="no mean, but SMPLer-X's",
    also=(
        _BODIES,
        replace(
            _BODIES,
            source="https://github.com/caizhongang/SMPLer-X/blob/main/main/inference.py",
            folder="smplx",
            files=r"(?P<frame>\d{1,9})_(?P<person>\d{1,9})",
            counted="mean",
        ),
    ),
)

HOT3D: Final = ManoLayout(
    "hot3d",
    "HOT3D",
    "mano_hand_pose_trajectory.jsonl, with wrist_xform and pose",
    "https://github.com/facebookresearch/hot3d/blob/main/hot3d/data_loaders/loader_hand_poses.py",
    "global_orient=q_wxyz transl=t_xyz hand_pose=pose betas time=timestamp_ns",
    needs="global_orient hand_pose transl time",
    met="its two samples (2026-11)",
    nested="wrist_xform",
    sides={"0": "left", "1": "right"},
    directions=True,
    counted="mean",
    world="y",
    assumes="directions and mean; y-up",
)
ARCTIC: Final = ManoLayout(
    "arctic",
    "ARCTIC",
    "a .mano.npy with rot, pose, trans and shape of left and right",
    "https://github.com/zc-alexfan/arctic/blob/master/common/body_models.py",
    "global_orient=rot hand_pose=pose transl=trans betas=shape",
    counted="mean",
    world="z",
    assumes="mean; z-up",
)
GRAB: Final = ManoLayout(
    "grab",
    "GRAB",
    "an .npz with lhand and rhand, which have params with fullpose",
    "https://github.com/otaheri/GRAB/blob/master/grab/grab_preprocessing.py",
    f"global_orient hand_pose=fullpose transl {_RATE}",
    nested="params",
    sides={"lhand": "left", "rhand": "right"},
    world="z",
    assumes="no mean; z-up",
)
INTERHAND: Final = ManoLayout(
    "interhand-mano",
    "InterHand2.6M",
    "_MANO.json of one capture: frames with pose, shape and trans of left and right",
    "https://github.com/facebookresearch/InterHand2.6M/blob/main/MANO_render/render.py",
    "transl=trans betas=shape",
    needs="global_orient hand_pose transl betas",
    columns={"pose": {48: _TURNS}},
    counted="mean",
    assumed=("its world was taken to have the camera's axes, without a camera",),
    assumes="mean; the world's axes are the camera's",
)
DEXYCB: Final = ManoLayout(
    "dexycb",
    "DexYCB",
    "a camera's folder with labels_000000.npz, or one of these, with pose_m",
    "https://github.com/NVlabs/dex-ycb-toolkit/blob/master/examples/visualize_pose.py",
    side="asked",
    columns={"pose_m": {51: {**_TURNS, "transl": slice(48, 51)}}},
    files=r"labels_(?P<frame>\d{1,9})",
    directions=True,
    counted="mean",
    assumes="directions and mean; a right hand, or `--hands`",
)
HO3D: Final = ManoLayout(
    "ho3d",
    "HO-3D",
    "a sequence's folder with meta/0000.pkl, or one of these, with handPose, handTrans and camMat",
    "https://github.com/shreyashampali/ho3d/blob/master/vis_HO3D.py",
    "transl=handTrans betas=handBeta intrinsics=camMat",
    needs="global_orient hand_pose transl intrinsics",
    side="right",
    columns={"handPose": {48: _TURNS}},
    folder="meta",
    files=r"\d+",
    world="OpenGL",
    assumes="no mean; a right hand, OpenGL's axes",
)
FREIHAND: Final = ManoLayout(
    "freihand",
    "FreiHAND",
    "training_mano.json, a list of 61 numbers a photo",
    "https://github.com/lmb-freiburg/freihand/blob/master/utils/model.py",
    needs="global_orient hand_pose",
    side="right",
    columns={"": {61: {**_TURNS, "betas": slice(48, 58)}}},
    counted="mean",
    assumes="mean; right hands",
)
