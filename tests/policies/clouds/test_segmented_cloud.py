"""Clouds of points alone: labels, AP and a page come out; another unit, network or size is refused."""

from pathlib import Path

import numpy as np
import pytest
import torch

from binpick_env.evaluation.segmentation.pictures import part_colours
from perception.geometry import Floats
from perception.instance import Instance
from perception.pose.edge_estimator import UNCHECKED, EdgePose
from perception.segmentation.networks.context_net import ContextNetConfig
from perception.segmentation.networks.grid_net import GridNetConfig
from perception.segmentation.point_files import read_points
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.weights import build_network, save_network
from policies.clouds.cloud_poses import pose_lines, pose_values
from policies.clouds.cloud_report import SIZE, VIEWS, draw_cloud
from policies.clouds.segmented_cloud import CloudSource, SegmentedCloud, cloud_lines, segment_cloud
from policies.commands.segment import main
from tests.perception.disc_scene import D_MAX, disc_scene

SMALL = ContextNetConfig(k=4, edge_k=3, edge=5, widths=(6, 7, 8), depths=(1, 1, 1), branch=9, embedding=4)
SCENE = disc_scene()


@pytest.fixture
def cloud_file(tmp_path: Path) -> Path:
    rows = zip(SCENE.boundary.points_cam.tolist(), SCENE.instance_ids.tolist(), strict=True)
    path = tmp_path / "discs.txt"
    path.write_text("\n".join(f"{x} {y} {z} {label}" for (x, y, z), label in rows))
    return path


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_network(tmp_path / "net.safetensors", build_network(SMALL), {"parts": []})
    return tmp_path / "net.safetensors"


class TrueParts(SegmentationPredictor):
    """Returns the true parts, and keeps the points that it was given."""

    def __init__(self) -> None:
        self.points: Floats = np.empty((0, 3))

    def predict(self, points, surface=None, d_max=None, shape=None) -> list[Instance]:  # type: ignore[no-untyped-def]
        self.points = points
        ids = SCENE.instance_ids
        return [Instance(point_idx=np.flatnonzero(ids == k), score=0.9) for k in range(ids.max() + 1)]


def segmented(path: Path, **settings: object) -> tuple[SegmentedCloud, TrueParts]:
    predictor = TrueParts()
    return segment_cloud(CloudSource(path=path, d_max=D_MAX, **settings), predictor), predictor


def test_true_parts_have_an_ap_of_1(cloud_file: Path) -> None:
    cloud, predictor = segmented(cloud_file)
    np.testing.assert_allclose(predictor.points, SCENE.boundary.points_cam)
    assert cloud.ap is not None
    assert cloud.ap.ap == 1.0
    assert cloud_lines(cloud)[-1] == "AP 1.000  AP50 1.000  AP75 1.000  over 6 labelled parts of at least 100 points"


def test_the_unit_and_the_axes_of_the_file(cloud_file: Path) -> None:
    _, predictor = segmented(cloud_file, scale=0.5, axes="opengl")
    np.testing.assert_allclose(predictor.points, 0.5 * SCENE.boundary.points_cam * (1, -1, -1))
    with pytest.raises(ValueError, match=r"discs.txt spans .* m, too much for parts of .*--scale"):
        segmented(cloud_file, scale=1e5)
    for settings, text in (
        ({"scale": 0.0}, "scale must be positive and finite, got 0.0"),
        ({"axes": "up"}, "axes must be one of opencv, opengl, got 'up'"),
    ):
        with pytest.raises(ValueError, match=text):
            segmented(cloud_file, **settings)


def test_parts_too_small_to_count_have_no_ap(cloud_file: Path) -> None:
    cloud_file.write_text("\n".join(cloud_file.read_text(encoding="utf-8").splitlines()[::20]))
    loaded = read_points(cloud_file)
    source = CloudSource(path=cloud_file, d_max=D_MAX)
    cloud = SegmentedCloud(source=source, loaded=loaded, points_cam=loaded.points, instances=[], ap=None, ms=1.0)
    assert cloud_lines(cloud) == [f"points    {len(loaded.points)}", "instances 0, with 0 of the points, in 1 ms"]
    measured = segment_cloud(source, SegmentationPredictor(build_network(SMALL), device="cpu"))
    assert "no AP: none of" in cloud_lines(measured)[-1]


def test_the_command_writes_labels_and_a_page(
    cloud_file: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main([str(cloud_file), "--d-max", str(D_MAX), "--weights", str(weights), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "points    980" in printed
    assert "AP50" in printed
    labels = read_points(out / "labels.txt")
    np.testing.assert_allclose(labels.points, SCENE.boundary.points_cam, rtol=1e-6)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 6  # three views of the instances and of the file's labels
    assert "http" not in page


def test_the_command_refuses_what_it_cannot_segment(
    cloud_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_network(tmp_path / "grid.safetensors", build_network(GridNetConfig()), {"parts": []})
    assert main([str(cloud_file), "--d-max", "0.05", "--poses"]) == 2
    assert "--poses needs --part" in capsys.readouterr().err
    assert main([str(cloud_file)]) == 2
    assert "the size of the part must be known: give --d-max [m] or --part" in capsys.readouterr().err
    grid = ["--weights", str(tmp_path / "grid.safetensors")]
    assert main([str(cloud_file), "--d-max", "0.05", *grid]) == 2
    assert "the image-plane network needs the pixels and the surface" in capsys.readouterr().err
    assert main([str(cloud_file), "--d-max", "-1", *grid]) == 2
    assert "d_max must be positive and finite, got -1.0" in capsys.readouterr().err
    assert main([str(tmp_path / "none.xyz"), "--d-max", "0.05", *grid]) == 2
    assert "none.xyz" in capsys.readouterr().err


def test_poses_say_what_was_not_checked(cloud_file: Path) -> None:
    cloud, _ = segmented(cloud_file)
    pose = EdgePose(T_cam_part=np.eye(4), instance_idx=3, explained=0.9, edges=0.5, verified=True)
    assert pose_lines([pose])[0] == "poses     1, 1 of them verified by their edges alone"
    assert [line.split(":")[0] for line in pose_lines([])[1:]] == [f"unchecked {u.split(':')[0]}" for u in UNCHECKED]
    values = pose_values(cloud, [pose])
    assert values["unchecked"] == list(UNCHECKED)
    assert values["poses"][0]["label"] == 3
    assert values["poses"][0]["T_cam_part"] == np.eye(4).tolist()


def test_the_nearest_point_is_drawn_last() -> None:
    points = np.array([[0.0, 0, 1], [1.0, 0.5, 1], [0.0, 0, 2]])
    for order in ([0, 1, 2], [2, 1, 0]):  # whatever the order of the file
        picture = draw_cloud(points[order], np.array([0, 0, 1])[order], (0.0, 0.0))
        assert picture.shape[1] == SIZE
        assert picture[10, 10].tolist() == part_colours(2)[0].tolist()


@pytest.mark.parametrize(
    ("view", "towards_viewer"),
    [
        ("from the camera", (0.0, 0.0, -1.0)),
        ("from below the image", (0.0, np.sqrt(0.75), -0.5)),  # y points down in the image
        ("from the right", (np.sqrt(0.75), 0.0, -0.5)),
    ],
)
def test_a_view_shows_the_cloud_from_where_its_caption_says(view: str, towards_viewer: tuple[float, ...]) -> None:
    points = np.array([np.zeros(3), 0.1 * np.array(towards_viewer), [1.0, 1.0, 0.0]])
    picture = draw_cloud(points, np.array([0, 1, -1]), VIEWS[view])
    behind, before = ((picture == colour).all(axis=2).any() for colour in part_colours(2))
    assert (behind, before) == (False, True)
