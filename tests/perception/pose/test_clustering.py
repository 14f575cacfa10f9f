"""Clusters of poses modulo symmetry."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import Floats, make_transform, rotation_about, transform_points
from perception.part import PartModel
from perception.pose.clustering import ClusterConfig, cluster_poses, rotations_within
from tests.perception.pose import posed_parts as at

CONFIG = ClusterConfig()
AHEAD = make_transform(None, (0.0, 0.0, 1.0))


def naive(T: Floats, scores: Floats, part: PartModel) -> list[tuple[int, float]]:
    """Return (representative, sum) by giving each pose in turn to the best representative it is near."""
    members: dict[int, list[int]] = {}
    for i in sorted(range(len(T)), key=lambda i: (-scores[i], i)):
        for representative in members:
            a, b = transform_points(T[i], part.centre[None]), transform_points(T[representative], part.centre[None])
            angle = part.symmetry.distance(T[i][:3, :3], T[representative][:3, :3])
            if np.linalg.norm(a - b) <= CONFIG.translation * part.d_max and angle <= CONFIG.rotation:
                members[representative].append(i)
                break
        else:
            members[i] = [i]
    sums = [(representative, float(sum(scores[i] for i in group))) for representative, group in members.items()]
    return sorted(sums, key=lambda entry: (-entry[1], entry[0]))


def around(T: Floats, part: PartModel, count: int, size: float, rng: np.random.Generator) -> list[Floats]:
    return [at.random_nearby(T, part, rng, size) @ at.random_element(part, rng) for _ in range(count)]


@pytest.mark.parametrize("part", at.PARTS, ids=lambda part: part.name)
def test_poses_that_differ_by_a_symmetry_are_one_cluster_given_by_the_best(part: PartModel) -> None:
    rng = np.random.default_rng(3)
    T = np.stack(around(at.random_pose(rng), part, 12, 0.01, rng))
    scores = rng.permutation(12).astype(float)
    representatives, sums = cluster_poses(T, scores, part)
    assert representatives.tolist() == [int(np.argmax(scores))]
    assert sums.tolist() == [66.0]


@settings(deadline=None, max_examples=25)
@given(part=st.sampled_from(at.PARTS), seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-9, 0.05, 0.15]))
def test_clusters_are_those_of_plain_loops(part: PartModel, seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    T = np.stack([T for _ in range(3) for T in around(at.random_pose(rng), part, 6, size, rng)])
    scores = rng.integers(0, 5, len(T)).astype(float)  # many ties
    representatives, sums = cluster_poses(T, scores, part)
    expected = naive(T, scores, part)
    assert representatives.tolist() == [representative for representative, _ in expected]
    assert sums == pytest.approx([total for _, total in expected])


def test_a_large_cluster_comes_before_a_single_better_pose() -> None:
    T = np.stack([AHEAD, *[make_transform(None, (0.5, 0.0, 1.0 + 1e-4 * k)) for k in range(3)]])
    representatives, sums = cluster_poses(T, np.array([5.0, 2.0, 3.0, 1.0]), at.cube())
    assert representatives.tolist() == [2, 0]
    assert sums.tolist() == [6.0, 5.0]


def test_a_turn_about_the_centre_is_no_shift_wherever_the_drawing_has_its_origin() -> None:
    part = at.lid()
    T = np.stack([AHEAD, AHEAD @ at.about_centre(part, at.HALF_TURN)])
    assert len(cluster_poses(T, np.ones(2), part)[0]) == 1
    T[1] = AHEAD @ make_transform(at.HALF_TURN)  # about the origin: the part lies elsewhere
    assert len(cluster_poses(T, np.ones(2), part)[0]) == 2


@pytest.mark.parametrize(("degrees", "share", "clusters"), [(14.5, 0, 1), (15.5, 0, 2), (0, 0.099, 1), (0, 0.101, 2)])
def test_the_limits_are_those_of_the_config(degrees: float, share: float, clusters: int) -> None:
    part = at.wedge()
    turn = at.about_centre(part, rotation_about((1.0, 2.0, 3.0), np.radians(degrees)))
    T = np.stack([AHEAD, make_transform(None, (share * part.d_max, 0.0, 0.0)) @ AHEAD @ turn])
    assert len(cluster_poses(T, np.ones(2), part)[0]) == clusters
    wide = ClusterConfig(translation=2 * CONFIG.translation, rotation=2 * CONFIG.rotation)
    assert len(cluster_poses(T, np.ones(2), part, wide)[0]) == 1


@pytest.mark.parametrize("part", at.PARTS, ids=lambda part: part.name)
def test_rotations_are_compared_as_the_symmetry_does(part: PartModel) -> None:
    rng = np.random.default_rng(0)
    T = at.random_pose(rng)
    others = np.stack([at.random_nearby(T, part, rng, 0.3)[:3, :3] for _ in range(50)])
    expected = [part.symmetry.distance(T[:3, :3], other) <= 0.3 for other in others]
    assert rotations_within(T[:3, :3], others, part.symmetry, 0.3).tolist() == expected
    assert 0 < sum(expected) < 50


def test_no_pose_is_no_cluster() -> None:
    representatives, sums = cluster_poses(np.zeros((0, 4, 4)), np.zeros(0), at.cube())
    assert representatives.shape == sums.shape == (0,)
    assert representatives.dtype == np.int64


def test_bad_poses_and_scores_are_refused() -> None:
    T, part = AHEAD[None], at.cube()
    with pytest.raises(ValueError, match=r"T_cam_part must be \(N, 4, 4\), got \(4, 4\)"):
        cluster_poses(AHEAD, np.ones(1), part)
    with pytest.raises(ValueError, match=r"scores must be \(1,\), got \(2,\)"):
        cluster_poses(T, np.ones(2), part)
    with pytest.raises(ValueError, match="T_cam_part must be finite"):
        cluster_poses(T * np.nan, np.ones(1), part)
    for score in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="scores must be finite and 0 or more"):
            cluster_poses(T, np.array([score]), part)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"translation": 0.0}, "translation must be positive, got 0.0"),
        ({"translation": np.nan}, "translation must be positive"),
        ({"rotation": 0.0}, r"rotation must be in \(0, pi\] rad, got 0.0"),
        ({"rotation": 15.0}, r"rotation must be in \(0, pi\] rad, got 15.0"),
    ],
)
def test_nonsense_in_the_config_is_refused(change: dict[str, Any], message: str) -> None:
    assert asdict(CONFIG).keys() >= change.keys()
    with pytest.raises(ValueError, match=message):
        replace(CONFIG, **change)
