"""The pictures show poses where they are, and the report shows every number and the worst scenes."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from binpick_env.config import CameraConfig
from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
from binpick_env.evaluation.pose.pictures import MISSED, RIGHT, WRONG, outline, outlines, pose_panels
from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.pose.report import write_pose_report
from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from binpick_env.evaluation.pose.summary import summarise_poses
from binpick_env.evaluation.segmentation.pictures import scene_panels
from binpick_env.evaluation.segmentation.record import record_path
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.geometry import camera_matrix, project_points
from perception.pose.model.appearances import EdgeAppearances, edge_appearances
from perception.runtime.records import RecordError
from tests.binpick_env.evaluation.pose.pose_records import bracket, estimates, moved, record

CORNER = (40, 20)


@pytest.fixture(scope="module")
def edges() -> EdgeAppearances:
    return edge_appearances(bracket(), subdivisions=1)


def pictured(*wrong: int, lost: tuple[int, ...] = ()) -> PoseRecord:
    """Return a scene with an image 900 wide; poses of parts in ``wrong`` are off, those in ``lost`` are not found."""
    scene = record()
    T = scene.T_cam_parts.copy()
    T[:, 0, 3] = np.linspace(-0.3, 0.3, len(T))
    poses = T.copy()
    for part in wrong:
        poses[part] = moved(T[part], 0.3)
    kept = [k for k in range(len(T)) if k not in lost]
    given = estimates(poses[kept], [0.9] * len(kept), kept)
    K = camera_matrix(900.0, 900, 400)
    grey = np.full((400, 900), 100, np.uint8)
    return replace(scene, T_cam_parts=T, picture=grey, corner=CORNER, K=K, **given)


def near(picture: np.ndarray, colour: tuple[int, int, int], pixel: np.ndarray) -> int:
    """Return how many pixels within 30 of one, in the camera's image, are of about this colour."""
    u, v = ((pixel - CORNER) / 2).astype(int)  # 900 pixels are shown as 450
    window = picture[max(v - 30, 0) : v + 30, max(u - 30, 0) : u + 30].astype(int)
    return int((np.abs(window - colour).max(axis=-1) < 40).sum())


def test_outlines_lie_on_the_boundary_points_of_their_parts() -> None:
    scenes = SceneConfig(part="bracket", seed=31, num_parts=(1, 1), sensor="none", camera=CameraConfig())
    scene, capture = make_scene(scenes, 0)
    edges = edge_appearances(bracket())
    strokes = outline(scene.T_cam_parts[0], edges, capture.frame.K, (0, 0))
    middles = strokes.mean(axis=1)
    apart = np.linalg.norm(middles[:, None] - scene.boundary.pixels, axis=-1).min(axis=1)
    assert np.mean(apart < 3.0) > 0.9
    lengths = np.linalg.norm(strokes[:, 1] - strokes[:, 0], axis=-1)
    assert lengths.max() < 2.2 * 0.012 * bracket().d_max * capture.frame.K[0, 0] / scene.T_cam_parts[0, 2, 3]
    moved_on = outline(scene.T_cam_parts[0], edges, capture.frame.K, (7, -5))
    np.testing.assert_allclose(strokes - moved_on, np.broadcast_to([7.0, -5.0], strokes.shape), atol=1e-9)


def test_right_is_green_wrong_is_red_and_missed_is_amber(edges: EdgeAppearances) -> None:
    scene = pictured(1, lost=(0,))
    picture = outlines(scene, PoseSceneScore.from_record(scene, 0, bracket()), edges)
    assert picture.shape == (200, 450, 3)
    pixels = project_points(scene.K, scene.T_cam_parts[:, :3, 3])
    for part, colour in enumerate((MISSED, WRONG, RIGHT, RIGHT)):
        counts = {each: near(picture, each, pixels[part]) for each in (RIGHT, WRONG, MISSED)}
        assert counts[colour] > 20
        # Part 1 is visible to more than a half and was missed by the pose that is off: it is drawn, too.
        others = {RIGHT, WRONG, MISSED} - {colour} - ({MISSED} if part == 1 else set())
        assert all(counts[other] == 0 for other in others)


def test_a_scene_has_its_image_its_groups_and_its_poses(edges: EdgeAppearances) -> None:
    scene = pictured()
    score = PoseSceneScore.from_record(scene, 0, bracket())
    panels = pose_panels(scene, score, edges)
    assert [panel.name for panel in panels] == ["image", "groups", "poses"]
    for panel in panels:
        assert cv2.imdecode(np.frombuffer(panel.data, np.uint8), cv2.IMREAD_COLOR).shape[:2] == (200, 450)
    bare = replace(scene, picture=np.zeros((0, 0), np.uint8))
    assert [panel.name for panel in pose_panels(bare, score, edges)] == ["groups"]
    whole = replace(scene, whole_scene=True, groups=np.full(4, -1))
    assert pose_panels(whole, score, edges)[1].name == "true segments"


def test_groups_are_drawn_as_they_were_predicted_and_true_segments_as_they_are(edges: EdgeAppearances) -> None:
    scene = replace(record(), labels=np.roll(record().labels, 60))  # a group is half of one part and half of another
    score = PoseSceneScore.from_record(scene, 0, bracket())
    expected = {panel.name: panel.data for panel in scene_panels(scene.segmentation())}
    assert expected["prediction"] != expected["truth"]
    (groups,) = pose_panels(scene, score, edges)
    assert groups.data == expected["prediction"]
    (segments,) = pose_panels(replace(scene, whole_scene=True, groups=np.full(4, -1)), score, edges)
    assert segments.data == expected["truth"]


def test_the_report_shows_the_worst_scenes_first(tmp_path: Path, edges: EdgeAppearances) -> None:
    scenes = [pictured(), pictured(0, 1), pictured(0)]
    for index, scene in enumerate(scenes):
        scene.save(record_path(tmp_path, index))
    scores = [PoseSceneScore.from_record(scene, k, bracket()) for k, scene in enumerate(scenes)]
    config = PoseEvaluationConfig(scenes=SceneConfig(part="bracket", seed=31))
    summary = summarise_poses(config, scores, np.random.default_rng(0), 50)
    page = tmp_path / "report.html"
    write_pose_report(page, summary, scores, tmp_path, edges, 2)
    text = page.read_text(encoding="utf-8")
    assert [text.index(f"<h3>Scene {k} <span>") for k in (1, 2)] == sorted(
        text.index(f"<h3>Scene {k} ") for k in (1, 2)
    )
    assert "<h3>Scene 0 " not in text
    assert "2 of 3 scenes" in text
    assert "0 of 2 parts found · 2 of 4 verified poses wrong · 1 of 3 trials recognised" in text
    for words in (
        "What a score is worth",
        "By visible fraction",
        "estimator: min_score",
        "another machine",
        "Precision",
    ):
        assert words in text
    assert text.count("<svg") == 2
    assert "nan" not in text.split("<h2>Scenes")[0]
    record_path(tmp_path, 1).unlink()
    with pytest.raises(RecordError, match=r"scene_00001\.npz does not hold a complete pose record"):
        write_pose_report(page, summary, scores, tmp_path, edges, 2)
