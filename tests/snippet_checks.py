"""What the Python snippets of each page must have found, besides the output that the page shows."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from perception.geometry import project_points

Names = dict[str, Any]  # what a page's snippets have defined, in the folder that they ran in
Check = Callable[[Names, str], None]  # of these names and of everything that was printed


def check_readme(names: Names, shown: str) -> None:
    assert names["observation"]["candidates"].dtype == np.float32
    assert -1 <= names["reward"] <= 1
    assert 20 <= names["info"]["total"] <= 30
    poses = names["seen"].poses
    assert len(poses) >= 10  # of 20 to 30 parts, most of which are covered
    assert _found(names, poses) >= 0.9 * len(poses)
    assert shown == f"{len(poses)} poses, the best scores {round(poses[0].score, 2)}\n"


def _found(names: Names, poses: Any) -> int:
    """Return how many poses have a true part's centre within 2 mm of theirs."""
    env = names["env"].unwrapped
    true = env.labelled_capture.T_reported_parts  # as the reported camera pose has them, in the world
    centre = np.append(names["pipeline"].estimator.part.centre, 1.0)
    centres = np.array([names["seen"].T_world_cam @ pose.T_cam_part @ centre for pose in poses])
    return int((np.linalg.norm(centres[:, None] - true @ centre, axis=2).min(axis=1) < 0.002).sum())


def check_diagnose_frames(names: Names, shown: str) -> None:
    right, millimetres, high = shown.split("boundary points")[1:]
    assert "no likely cause" in right
    assert "likely cause" in millimetres
    assert "multiply it by 0.001" in millimetres
    assert "the bin seems to stand lower" in high
    assert names["spoiled"].depth.max() > 500


def check_measure_bin(names: Names, shown: str) -> None:
    assert abs(names["distance"] - 0.010) < 0.0005
    assert abs(np.degrees(names["angle"]) - 2.0) < 0.05
    # The last run trusts the bin: camera, bin and part stand where they are.
    camera, bin_, _ = names["places"]
    assert abs(camera - names["frame"].T_world_cam[0, 3]) < 0.0005
    assert abs(bin_ - names["workspace"].T_world_bin[0, 3]) < 0.0005
    assert abs(names["wrong"][0, 3] - names["frame"].T_world_cam[0, 3] - 0.010) < 1e-9


def check_own_arrays(names: Names, shown: str) -> None:
    poses = names["seen"].poses
    assert 4 <= len(poses) <= 6
    assert _found(names, poses) == len(poses)
    # Sorted by score, and the same with two threads as what was printed before with one.
    scores = [f"{pose.score:.2f}" for pose in poses]
    assert [line.split()[0] for line in shown.splitlines()] == scores == sorted(scores, reverse=True)
    places = np.array([line.split("[")[1].rstrip("]").split() for line in shown.splitlines()], float)
    true = names["env"].labelled_capture.T_reported_parts[:, :3, 3]
    assert np.linalg.norm(places[:, None] - true, axis=2).min(axis=1).max() < 0.003


def check_own_picker(names: Names, shown: str) -> None:
    assert shown == "0 of 4 abstained\n100.0\nFalse\n"
    assert names["env"].unwrapped.config.robot.protective_stop == 100.0


def check_perceive_frames(names: Names, shown: str) -> None:
    assert shown == "the bin's floor is at [0.5  0.   0.02]\n"
    written = {path.name for path in Path().iterdir()}
    images = {f"bin_0{k}{end}" for k in (1, 2) for end in (".json", "_depth.png", "_grey.png")}
    assert written == images | {"cell.json"}


def check_read_frames(names: Names, shown: str) -> None:
    depth = names["depth"]
    np.testing.assert_allclose(names["frame"].depth, depth, atol=0.0005)
    np.testing.assert_allclose(names["cropped"].depth, np.rot90(depth[150:350, 200:440], 1), atol=0.0005)
    np.testing.assert_allclose(names["organised"].depth, depth, atol=1e-6)
    np.testing.assert_allclose(names["projected"].depth, depth, atol=1e-6)
    np.testing.assert_array_equal(names["again"].depth, names["frame"].depth)
    lines = shown.splitlines()
    assert lines[:3] == ["(480, 640) 0.900 m", "(240, 200) [ 89.5 119.5]", "True none 1.000"]
    assert lines[3].startswith("[[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]]")
    assert lines[4:] == ["projected cloud 0", "(480, 640)", "True 0.9"]


def check_segment_points(names: Names, shown: str) -> None:
    capture, instances = names["env"].labelled_capture.capture, names["instances"]
    assert [int(line.split()[0]) for line in shown.splitlines()] == [len(each.point_idx) for each in instances]
    pixels = np.rint(project_points(capture.frame.K, names["points_cam"])).astype(int)
    true = capture.instance_ids[pixels[:, 1], pixels[:, 0]]
    separated = set()
    for instance in instances:
        own = true[instance.point_idx]
        part = int(np.bincount(own[own >= 0]).argmax())
        both, either = (own == part).sum(), (true == part).sum() + (own != part).sum()
        if both > 0.5 * either:
            separated.add(part)
    assert len(separated) >= 4  # of six parts, by a young network


def check_watch(names: Names, shown: str) -> None:
    (film,) = Path("films").iterdir()
    assert shown == f"{[film.name]}\n"
    assert film.read_bytes()[4:8] == b"ftyp"


def check_researcher(names: Names, shown: str) -> None:
    found = names["instances_of"](names["labels"], scores=[0.9, 0.8])
    assert [(instance.point_idx.tolist(), instance.score) for instance in found] == [([0, 1], 0.9), ([2, 3], 0.8)]
    assert shown == f"{found}\n"


def check_selector(names: Names, shown: str) -> None:
    assert shown == "delivered 1 of 4\n"
    assert names["reward"] > 0


CHECKS: dict[str, Check] = {
    "README.md": check_readme,
    "docs/howto/diagnose_frames.md": check_diagnose_frames,
    "docs/howto/measure_bin.md": check_measure_bin,
    "docs/howto/own_arrays.md": check_own_arrays,
    "docs/howto/own_picker.md": check_own_picker,
    "docs/howto/perceive_frames.md": check_perceive_frames,
    "docs/howto/read_frames.md": check_read_frames,
    "docs/howto/segment_points.md": check_segment_points,
    "docs/howto/watch.md": check_watch,
    "docs/tutorials/researcher.md": check_researcher,
    "docs/tutorials/selector.md": check_selector,
}
