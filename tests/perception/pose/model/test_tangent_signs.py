"""Tangents are lines: voting must not depend on their signs, and the ways that do so show why it is built as it is."""

import numpy as np
import pytest

from perception.pose.hypotheses.voting import RawPoses, vote
from perception.pose.model.pair_features import PairConfig
from tests.perception.pose.bracket_scene import (
    BRACKET,
    EVERY,
    STEP,
    D,
    bracket_scene,
    bracket_table,
    is_right,
    sample,
    share_right,
)
from tests.perception.pose.pair_tables import table_of


def test_the_signs_of_tangents_change_nothing_beyond_a_bin():
    rng = np.random.default_rng(6)
    points, tangents, T_cam_part, _ = bracket_scene(rng)
    references = np.arange(0, len(points), 10)
    table = bracket_table()
    negated = tangents * rng.permutation(np.resize([-1.0, 1.0], len(tangents)))[:, None]
    one, other = (vote(table, points, t, references, EVERY) for t in (tangents, negated))
    first = {int(r): k for k, r in reversed(list(enumerate(one.reference)))}
    second = {int(r): k for k, r in reversed(list(enumerate(other.reference)))}
    assert set(first) == set(second) == set(references)
    same = 0
    for r, k in first.items():
        # Bins are laid out from another zero, so that votes differ a little; equal poses still agree within a bin.
        T = other.T_cam_part[second[r]]
        same += bool(is_right(RawPoses(T_cam_part=T[None], votes=np.ones(1), reference=np.zeros(1)), one.T_cam_part[k]))
        assert other.votes[second[r]] == pytest.approx(one.votes[k], rel=0.2)
    assert same >= 0.95 * len(first)
    assert share_right(one, T_cam_part, references) >= 0.95
    assert share_right(other, T_cam_part, references) >= 0.95


def test_a_model_with_negated_tangents_finds_the_same():
    points, tangents, T_cam_part, _ = bracket_scene(np.random.default_rng(7))
    model, model_tangents = sample(BRACKET, STEP * D)
    model_tangents[::2] *= -1
    table = table_of(model, model_tangents, np.ones(len(model), np.uint32), D)
    references = np.arange(0, len(points), 10)
    assert share_right(vote(table, points, tangents, references, EVERY), T_cam_part, references) >= 0.95


def share_found(signs, scene):
    """Return the share of every third reference on the part that finds its pose."""
    points, tangents, T_cam_part, on_part = scene
    references = np.flatnonzero(on_part)[::3]
    raw = vote(bracket_table(PairConfig(signs=signs)), points, tangents, references, EVERY)
    return share_right(raw, T_cam_part, references)


@pytest.mark.parametrize("seed", range(3))
def test_with_random_signs_only_the_safe_feature_finds_the_part_at_every_reference(seed):
    scene = bracket_scene(np.random.default_rng(seed))
    assert share_found("safe", scene) >= 0.98
    # Half of the tangents point against the model's: no reference there can be right.
    assert share_found("no_flip", scene) <= 0.65
    assert share_found("raw", scene) <= 0.65


@pytest.mark.parametrize("signs", ["safe", "no_flip", "raw"])
def test_without_a_wrong_sign_every_feature_finds_the_part(signs):
    model, tangents = sample(BRACKET, STEP * D)
    T_cam_part = np.eye(4)
    references = np.arange(0, len(model), 5)
    raw = vote(bracket_table(PairConfig(signs=signs)), model, tangents, references, EVERY)
    assert share_right(raw, T_cam_part, references) >= 0.95


def test_raw_signs_lose_half_of_the_votes_and_a_forgotten_flip_none():
    scene = bracket_scene(np.random.default_rng(4))
    points, tangents, T_cam_part, _ = scene
    votes = {}
    for signs in ("safe", "no_flip", "raw"):
        raw = vote(bracket_table(PairConfig(signs=signs)), points, tangents, None, EVERY)
        votes[signs] = raw.votes[is_right(raw, T_cam_part)].mean()
    assert votes["raw"] < 0.65 * votes["safe"]
    assert votes["no_flip"] > 0.9 * votes["safe"]


def test_only_safe_features_vote_for_tangents_that_point_against_the_models():
    model, tangents = sample(BRACKET, STEP * D)
    references = np.arange(0, len(model), 5)
    share = {
        signs: share_right(
            vote(bracket_table(PairConfig(signs=signs)), model, -tangents, references, EVERY), np.eye(4), references
        )
        for signs in ("safe", "no_flip", "raw")
    }
    assert share["safe"] >= 0.95
    assert share["no_flip"] == share["raw"] == 0
