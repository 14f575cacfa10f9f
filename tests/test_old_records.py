"""Files that the code of commit 3e3d809 wrote are read, with the values that were put into them."""

from pathlib import Path

import numpy as np
import torch

from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.segmentation.record import SceneRecord
from perception.s3dis.data.room import Room
from perception.s3dis.evaluation.judged import load_judged
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.weights import load_network, load_record
from policies.evaluation.records import load_record as load_bin_record
from policies.selection.weights import load_selector_net, load_selector_record

OLD = Path(__file__).parent / "golden" / "records_v1"
K = [[600.0, 0.0, 310.5], [0.0, 620.0, 245.25], [0.0, 0.0, 1.0]]
PIXELS = [[300, 200], [320, 260], [10, 470]]
T_CAM_PARTS = [
    [[1, 0, 0, 0.01], [0, 1, 0, 0.02], [0, 0, 1, 0.5], [0, 0, 0, 1]],
    [[0, -1, 0, -0.1], [1, 0, 0, 0.05], [0, 0, 1, 0.75], [0, 0, 0, 1]],
]


def test_a_scene() -> None:
    scene = BoundaryScene.load(OLD / "scene.npz")
    assert (scene.part, scene.d_max) == ("tee", 0.08)
    assert (scene.K.tolist(), scene.boundary.pixels.tolist()) == (K, PIXELS)
    expected = [[-10.5 / 600 * 0.5, -45.25 / 620 * 0.5, 0.5], [9.5 / 600 * 0.75, 14.75 / 620 * 0.75, 0.75]]
    np.testing.assert_allclose(scene.boundary.points_cam[:2], expected, rtol=1e-12)
    assert scene.boundary.tangents_cam.tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 0]]
    np.testing.assert_allclose(scene.boundary.linearity, [1, 0, 0.2])
    np.testing.assert_allclose(scene.surface.depth, [[0.5, 0], [0.75, 1.25]], rtol=1e-6)
    assert (scene.surface.u0, scene.surface.v0, scene.surface.cell) == (4.5, 8.25, 6.0)
    assert scene.instance_ids.tolist() == [0, 1, -1]
    assert scene.T_cam_parts.tolist() == T_CAM_PARTS
    np.testing.assert_array_equal(scene.centres_cam, np.array(T_CAM_PARTS)[:, :3, 3] + 0.001)
    assert scene.visible_fractions.tolist() == [0.25, 0.875]


def test_a_segmentation_record() -> None:
    record = SceneRecord.load(OLD / "segmentation_record.npz")
    assert (record.labels.tolist(), record.scores.tolist()) == ([0, 1, -1], [0.75, 0.5])
    assert (record.instance_ids.tolist(), record.visible_fractions.tolist()) == ([0, 1, -1], [0.25, 0.875])
    assert (record.pixels.tolist(), record.picture.tolist(), record.corner) == (PIXELS, [[0, 1, 2], [3, 4, 5]], (7, 9))
    assert (record.wrong_side, record.contour, record.threads, record.git_commit) == (1, 4, 2, "0123456789ab")
    assert record.ms == {"boundary": 1.5, "surface": 2.5, "segmentation": 3.5, "total": 7.5}


def test_a_pose_record() -> None:
    record = PoseRecord.load(OLD / "pose_record.npz")
    assert (record.labels.tolist(), record.instance_ids.tolist()) == ([0, 1, -1], [0, 1, -1])
    assert (record.explained.tolist(), record.explained_confidences.tolist()) == ([-1, 0, 0], [0.625])
    assert (record.confidences.tolist(), record.visible_fractions.tolist()) == ([0.75, 0.5], [0.25, 0.875])
    assert (record.T_cam_parts.tolist(), record.poses.tolist()) == (T_CAM_PARTS, T_CAM_PARTS[1:])
    assert (record.trials.tolist(), record.groups.tolist(), record.scores.tolist()) == ([1, 0], [1], [0.9375])
    assert (record.estimated_fractions.tolist(), record.verified.tolist(), record.whole_scene) == (
        [0.375],
        [True],
        False,
    )
    assert record.verdicts.tolist() == [[k / 8 for k in range(8)]]
    assert (record.K.tolist(), record.pixels.tolist(), record.corner) == (K, PIXELS, (7, 9))
    spent = dict(record.ms)
    assert np.isnan(spent.pop("trials"))
    stages = {"boundary": 1.5, "surface": 2.5, "segmentation": 3.5, "pose": 4.5, "explanation": 6.5, "total": 12.0}
    assert spent == stages


def test_a_room() -> None:
    room = Room.load(OLD / "room.npz")
    assert (room.name, room.source, room.remarks) == ("Area_5/office_1", "abc", ("one", "and two"))
    assert room.xyz.tolist() == (np.arange(9.0).reshape(3, 3) / 8).tolist()
    assert room.rgb.tolist() == np.arange(9).reshape(3, 3).tolist()
    assert (room.semantic.tolist(), room.instance.tolist()) == ([0, 2, 2], [0, 1, 1])


def test_a_judged_row() -> None:
    judged = load_judged(OLD / "judged.json")
    assert (judged.row, judged.seed, judged.names) == ("sgpn-colour", 3, ("Area_5/office_1",))
    (matches,) = judged.matches
    assert (matches.overlaps, matches.truth_counts) == ((0.5, 0.25), {1: 4, 2: 0})
    assert (matches.labels.tolist(), matches.overlap_idx.tolist()) == ([1, 1], [0, 1])
    assert (matches.scores.tolist(), matches.correct.tolist()) == ([0.1, 0.7], [False, True])


def filled(shape: torch.Size, index: int) -> torch.Tensor:
    """Return what parameter ``index`` of a golden network was filled with."""
    return (torch.arange(shape.numel(), dtype=torch.float32).reshape(shape) % 7 - 3) / 8 + index / 64


def test_networks() -> None:
    path = OLD / "grid_network.safetensors"
    record = load_record(path)
    assert (record["version"], record["kind"], record["parts"], record["steps"]) == (1, "grid", ["tee"], 7)
    selector = load_selector_net(OLD / "selector.safetensors")
    assert selector.config.hidden == 2
    assert load_selector_record(OLD / "selector.safetensors")["algorithm"] == "bandit"
    for network, tolerance in ((load_network(path), 2e-3), (selector, 0.0)):  # the first was stored in 16 bits
        for index, parameter in enumerate(network.parameters()):
            torch.testing.assert_close(parameter.detach(), filled(parameter.shape, index), rtol=tolerance, atol=0.0)


def test_a_bin_record() -> None:
    record = load_bin_record(OLD / "bin_record.json")
    assert (record.config_hash, record.index, record.seed, record.parts_total) == ("abc", 2, 17, 2)
    assert (record.termination, record.lost, record.before, record.after) == ("empty", 1, "before.jpg", "")
    assert (record.wall, record.settle, record.render, record.git_commit) == (12.5, 1.5, 2.5, "0123456789ab")
    assert (record.clutter.median, record.clutter.above_nine_tenths) == (0.625, 0.0)
    assert np.isnan(record.clutter.below_half)
    slipped, abstained = record.picks
    assert (slipped.outcome, slipped.failure_attribution) == ("slipped", "grasp")  # "blame" in the file
    assert (slipped.candidate, slipped.picture) == (0, "pick.jpg")
    assert (slipped.width, slipped.opening, slipped.score, slipped.features) == (0.03, 0.05, 0.5, {"height": 0.125})
    assert (slipped.t_sense, slipped.t_compute, slipped.t_motion, slipped.frame_id) == (0.5, 0.25, 4.0, 4)
    assert (abstained.outcome, abstained.abstention, abstained.width) == (None, "no_candidate", None)
    (frame,) = record.frames
    assert (frame.frame_id, frame.visible_fractions, frame.ms) == (4, (0.75, 0.5), {"total": 12.5})
    right, wrong = frame.candidates
    assert (right.part, right.score, right.right, right.found) == (0, 0.75, True, 0)
    assert (right.translation, right.rotation, right.overlap) == (0.001, 0.125, 0.625)
    assert (wrong.part, wrong.right, wrong.found, wrong.overlap) == (-1, False, -1, None)
    assert frame.segments is not None
    assert frame.segments.scores == (0.75, 0.5)
    assert [tuple(row) for row in frame.segments.points] == [(-1, 0, 3), (0, 0, 5), (1, 1, 4)]
    assert frame.explained is None
