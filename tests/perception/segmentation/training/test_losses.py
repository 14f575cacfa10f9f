"""The loss terms: four points by hand, plain loops, unbiased anchors, gradients where they are delicate.

Shapes: B clouds, N points, F dimensions of the embedding, A anchors, S semantic classes.
"""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.segmentation.training import anchors as anchor_draws
from perception.segmentation.training import losses as losses_module
from perception.segmentation.training.losses import (
    PairLossConfig,
    PointAttributes,
    confidence_loss,
    offset_loss,
    pair_loss,
    semantic_loss,
)
from tests.perception.segmentation.training.loss_cases import (
    ALL,
    DISTANCES,
    KINDS,
    LINE_CLASSES,
    LINE_IDS,
    TWIN,
    in_reading,
    on_a_line,
    scene,
    value_and_gradient,
)


# D: 01 7, 02 9, 03 50, 12 2, 13 43, 23 41 (L2);  0.8: S 01 6.4, 02 10, 03 40, 12 0.4, 13 14.4, 23 10 (10 d^2).
# alpha 3, beta 2. Pairs 02, 03, 12, 13, 23 cost 3(10-9) + (80-50) + 3(10-2) + 37 + 39 = 133 (L2),
# 0 + 40 + 3(9.6) + 65.6 + 70 = 204.4 (10 d^2); pair 01 costs D in eq. (1), 2(D - 5) in eq. (2).
# Every pair counts twice, and there are 16.
@pytest.mark.parametrize(
    ("kind", "distance", "line", "by_hand"),
    [
        ("double_hinge", "l2", (0, 7, 9, 50), 2 * (133 + 7) / 16),  # 17.5
        ("focal_double_hinge", "l2", (0, 7, 9, 50), 2 * (133 + 4) / 16),  # 17.125
        ("double_hinge", "scaled_square", (0, 0.8, 1, 2), 2 * (204.4 + 6.4) / 16),  # 26.35
        ("focal_double_hinge", "scaled_square", (0, 0.8, 1, 2), 2 * (204.4 + 2.8) / 16),  # 25.9
    ],
)
def test_four_points_by_hand(kind, distance, line, by_hand):
    config = PairLossConfig(kind=kind, distance=distance, anchors=None)
    value = pair_loss(on_a_line(*line), LINE_IDS, config, 3.0, attributes=PointAttributes(LINE_CLASSES))
    assert value.item() == pytest.approx(by_hand, rel=1e-12)


def test_gradient_of_four_points_by_hand():
    # By x0: pair 01 pulls with -beta, 02 pushes with +alpha, 03 with +1, each twice of 16; and so on.
    _, gradient = value_and_gradient(
        on_a_line(0, 7, 9, 50), LINE_IDS, ALL, 3.0, attributes=PointAttributes(LINE_CLASSES)
    )
    by_hand = torch.tensor([-2 + 3 + 1, 2 + 3 + 1, -3 - 3 + 1, -1 - 1 - 1]) * 2 / 16
    torch.testing.assert_close(gradient.flatten(), by_hand.double(), rtol=1e-12, atol=0)


def test_single_class_is_the_default():
    embedding = on_a_line(0, 7, 9, 12)
    # 01 2(7-5), 02 3(10-9), 12 3(10-2), 13 3(10-5), 23 3(10-3); 03 is beyond M2.
    assert pair_loss(embedding, LINE_IDS, ALL, 3.0).item() == pytest.approx(2 * (4 + 3 + 24 + 15 + 21) / 16)


def test_points_of_two_classes_are_case_3_even_in_one_instance():
    classes = PointAttributes(torch.tensor([[0, 1]]))
    value = pair_loss(on_a_line(0, 30), torch.tensor([[4, 4]]), ALL, 3.0, attributes=classes)
    assert value.item() == pytest.approx(2 * (80 - 30) / 4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("weighting", ["none", "inverse_frequency"])
@pytest.mark.parametrize("reach", [None, 0.5])
@pytest.mark.parametrize("classes", [False, True])
def test_pair_loss_is_its_twin(kind, distance, weighting, reach, classes):
    config = PairLossConfig(
        kind=kind, distance=distance, weighting=weighting, reach=reach, beta=1.7, category=30.0, anchors=None
    )
    s = scene(3)
    s.classes[0, :2] = -1
    embedding = in_reading(config, s.embedding)
    class_ids = s.classes if classes else None
    listed = s.classes.tolist() if classes else None
    want = TWIN.pair_loss(embedding.tolist(), s.ids.tolist(), config, 2.3, listed, s.points.tolist())
    for anchors in (None, 14, 1000):  # as many anchors as points are all of them, each once
        got = pair_loss(
            embedding, s.ids, replace(config, anchors=anchors), 2.3, attributes=PointAttributes(class_ids, s.points)
        )
        assert got.item() == pytest.approx(want, rel=1e-8)  # a point's distance to itself is 1e-8, not 0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), points=st.integers(1, 9), clouds=st.integers(1, 3), instances=st.integers(1, 5))
def test_property_small_scenes(seed, points, clouds, instances):
    s = scene(seed, clouds=clouds, points=points, instances=instances)
    want = TWIN.pair_loss(s.embedding.tolist(), s.ids.tolist(), ALL, 2.0)
    assert pair_loss(s.embedding, s.ids, ALL, 2.0).item() == pytest.approx(want, rel=1e-11, abs=1e-12)
    order = torch.randperm(points)
    moved = s.embedding[:, order] + 100.0
    renamed = torch.where(s.ids >= 0, 1000 - 7 * s.ids, -1)[:, order]
    assert pair_loss(moved, renamed, ALL, 2.0).item() == pytest.approx(want, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("weighting", ["none", "inverse_frequency"])
def test_gradient_is_that_of_finite_differences(kind, distance, weighting):
    config = PairLossConfig(kind=kind, distance=distance, weighting=weighting, reach=0.6, category=30.0, anchors=5)
    s = scene(11, clouds=2, points=8)

    def of_embedding(embedding):
        generator = torch.Generator().manual_seed(5)
        return pair_loss(
            embedding, s.ids, config, 2.3, attributes=PointAttributes(s.classes, s.points), generator=generator
        )

    assert torch.autograd.gradcheck(of_embedding, in_reading(config, s.embedding).requires_grad_())


def test_outer_gradient_scales_and_no_gradient_is_fine():
    s = scene(1)
    _, gradient = value_and_gradient(s.embedding, s.ids, ALL, 2.0)
    embedding = s.embedding.clone().requires_grad_()
    (-3 * pair_loss(embedding, s.ids, ALL, 2.0)).backward()
    torch.testing.assert_close(embedding.grad, -3 * gradient)
    assert not pair_loss(s.embedding, s.ids, ALL, 2.0).requires_grad


def test_blocks_do_not_change_the_result(monkeypatch):
    s = scene(2)
    args = (s.embedding, s.ids, replace(ALL, reach=0.5), 2.0)
    whole = value_and_gradient(*args, attributes=PointAttributes(s.classes, s.points))
    confidence = confidence_loss(s.confidence, s.embedding, s.ids, ALL)
    monkeypatch.setitem(losses_module.BLOCK_ELEMENTS, "cpu", 3 * 14 * 4)  # 4 anchors at once, of 14
    torch.testing.assert_close(value_and_gradient(*args, attributes=PointAttributes(s.classes, s.points)), whole)
    torch.testing.assert_close(confidence_loss(s.confidence, s.embedding, s.ids, ALL), confidence)


# Anchors


@pytest.mark.parametrize("anchors", [1, 3, 6, 11])  # fewer than, about as many as, and more than instances
@pytest.mark.parametrize("weighting", ["none", "inverse_frequency"])
def test_anchors_expect_all_pairs_exactly(anchors, weighting, monkeypatch):
    s = scene(7, clouds=1, points=20, instances=5)
    config = PairLossConfig(weighting=weighting, anchors=anchors)
    want = value_and_gradient(s.embedding, s.ids, replace(config, anchors=None), 2.0)
    want_confidence = confidence_loss(s.confidence, s.embedding, s.ids, ALL)
    probability = anchor_draws.anchor_probability(s.ids, anchors)
    order = torch.where(s.ids >= 0, s.ids, 99).argsort(dim=1, stable=True)
    # The sample changes only where start + k passes a bound, so between two such starts any start stands for all.
    bounds = probability.gather(1, order).cumsum(1)
    starts = torch.cat([torch.zeros(1), (bounds % 1).flatten().sort().values, torch.ones(1)]).double()
    value, gradient, confidence = torch.zeros(()).double(), torch.zeros_like(s.embedding), torch.zeros(()).double()
    for low, high in pairwise(starts):
        if high - low < 1e-9:
            continue
        drawn = anchor_draws.systematic_sample(probability, order, (low + high)[None, None] / 2, anchors)
        monkeypatch.setattr(losses_module, "draw_anchors", lambda *_, drawn=drawn: drawn)
        part = value_and_gradient(s.embedding, s.ids, config, 2.0)
        value, gradient = value + (high - low) * part[0], gradient + (high - low) * part[1]
        confidence = confidence + (high - low) * confidence_loss(s.confidence, s.embedding, s.ids, config)
    torch.testing.assert_close((value, gradient), want, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(confidence, want_confidence, rtol=1e-9, atol=1e-12)


def test_many_draws_average_to_all_pairs():
    s = scene(8, clouds=1, points=40, instances=6)
    generator, config = torch.Generator().manual_seed(0), PairLossConfig(anchors=9)
    draws = torch.stack([pair_loss(s.embedding, s.ids, config, 2.0, generator=generator) for _ in range(600)])
    error = (draws.mean() - pair_loss(s.embedding, s.ids, ALL, 2.0)).abs()
    assert draws.std() > 0
    assert error < 4 * draws.std() / 600**0.5
    assert draws.std() / draws.mean() < 0.2  # nine anchors of forty points are not a bad guess


def test_anchor_probabilities():
    ids = torch.tensor([[0] * 50 + [1] * 8 + [2] + [-1], [5] * 3 + [-1] * 57])
    probability = anchor_draws.anchor_probability(ids, 10)
    torch.testing.assert_close(probability.sum(1), torch.tensor([10.0, 3.0]).double())
    # One each, the seven others by (size - 1) / (59 - 3).
    torch.testing.assert_close(probability[0, 50].item(), (1 + 7 * 7 / 56) / 8)
    assert probability[0, 58] == 1
    assert probability[0, 59] == 0
    assert (probability[1, :3] == 1).all()
    fewer = anchor_draws.anchor_probability(ids, 2)[0]
    torch.testing.assert_close(fewer[[0, 50, 58]], torch.tensor([2 / 150, 2 / 24, 2 / 3]).double())


def test_every_instance_is_seen_and_void_never():
    ids = torch.tensor([[0] * 60 + [1] * 30 + [2] + [3] + [-1] * 20])
    generator = torch.Generator().manual_seed(0)
    seen, gaps = set(), []
    for _ in range(50):
        index, weight = anchor_draws.draw_anchors(ids, 6, generator)
        assert set(ids[0, index[0]].tolist()) == {0, 1, 2, 3}
        assert (weight > 0).all()
        assert len(set(index[0].tolist())) == 6
        seen |= set(index[0].tolist())
        gaps.append(index[index < 60].sort().values.diff().min().item())
    assert len(seen) > 80
    assert min(gaps) < 5  # at random within an instance: in the points' order anchors would lie 25 apart


def test_draws_follow_the_generator():
    s = scene(4)
    config = PairLossConfig(anchors=4)
    first, again, other = (
        pair_loss(s.embedding, s.ids, config, 2.0, generator=torch.Generator().manual_seed(k)) for k in (0, 0, 1)
    )
    assert first == again
    assert first != other


# Delicate inputs


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_coinciding_points_have_a_finite_gradient(kind, distance, dtype):
    config = PairLossConfig(kind=kind, distance=distance, anchors=None)
    embedding = torch.full((1, 6, 3), 123.4, dtype=dtype)
    value, gradient = value_and_gradient(embedding, torch.tensor([[0, 0, 0, 1, 1, 1]]), config, 2.0)
    assert value.item() == pytest.approx(2.0 * 10 / 2, rel=1e-4)  # half of the pairs are of two instances
    assert gradient.abs().max() < 1e-6


def test_near_coincident_points_far_from_the_origin_keep_their_gradient():
    # In float32 |f|^2 of 10^5 would drown a distance of 0.01.
    near = torch.tensor([[[0.0, 0.0], [0.006, 0.008], [3.0, 4.0]]]) + torch.tensor([200.0, 300.0])
    config = PairLossConfig(kind="double_hinge", anchors=None)
    _, exact = value_and_gradient(near.double(), torch.tensor([[0, 0, 0]]), config, 2.0)
    _, gradient = value_and_gradient(near, torch.tensor([[0, 0, 0]]), config, 2.0)
    torch.testing.assert_close(gradient.double(), exact, rtol=1e-4, atol=1e-6)
    # Each of the two is pulled to the other with 1 and to the third, in nearly the same direction, with 1; twice of 9.
    assert gradient[0, 0].norm().item() == pytest.approx(2 * 2 / 9, rel=1e-2)


@pytest.mark.parametrize("anchors", [None, 5])
def test_void_points_take_no_part(anchors):
    config, s = PairLossConfig(anchors=anchors), scene(5)
    void = s.ids == -1

    def terms(embedding):
        generator = torch.Generator().manual_seed(0)
        pairs = value_and_gradient(embedding, s.ids, config, 2.0, generator=generator)
        return *pairs, confidence_loss(s.confidence, embedding, s.ids, config, generator=generator)

    first = terms(s.embedding)
    second = terms(torch.where(void[..., None], 77.0, s.embedding))
    torch.testing.assert_close(first, second)
    assert (first[1][void] == 0).all()
    assert (first[1][~void] != 0).any()


@pytest.mark.parametrize("ids", [[[-1, -1]], [[3, -1]], [[3, -1], [-1, -1]], [[]]])
@pytest.mark.parametrize("anchors", [None, 4])
def test_without_pairs_the_terms_are_zero_and_have_a_gradient(ids, anchors):
    ids = torch.tensor(ids, dtype=torch.int64)
    config = PairLossConfig(anchors=anchors)
    value, gradient = value_and_gradient(torch.ones(*ids.shape, 3), ids, config, 2.0)
    assert value == 0
    assert (gradient == 0).all()
    ones = torch.ones(*ids.shape)  # a point alone is its own group: IoU 1
    value, gradient = value_and_gradient(ones, torch.ones(*ids.shape, 3), ids, config, loss=confidence_loss)
    assert value == 0
    assert (gradient == 0).all()


@pytest.mark.parametrize("anchors", [None, 4])
def test_a_batch_is_the_mean_of_its_clouds(anchors):
    s, config = scene(9), PairLossConfig(anchors=anchors, weighting="inverse_frequency")
    if anchors is not None:  # no more points than anchors, so that there is nothing to draw
        s.ids[:, 4:] = -1
    alone = [pair_loss(s.embedding[b : b + 1], s.ids[b : b + 1], config, 2.0) for b in range(3)]
    torch.testing.assert_close(pair_loss(s.embedding, s.ids, config, 2.0), torch.stack(alone).mean())
    padded = pair_loss(
        torch.cat([s.embedding, s.embedding[:1]]), torch.cat([s.ids, torch.full((1, 14), -1)]), config, 2.0
    )
    torch.testing.assert_close(padded, torch.stack(alone).mean())


def test_half_precision_is_computed_in_float32():
    s = scene(6, dtype=torch.bfloat16)
    want, want_gradient = value_and_gradient(s.embedding.float(), s.ids, ALL, 2.0)
    confidence = s.confidence.bfloat16()
    want_confidence = confidence_loss(confidence.float(), s.embedding.float(), s.ids, ALL)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        value, gradient = value_and_gradient(s.embedding, s.ids, ALL, 2.0)
        got_confidence = confidence_loss(confidence, s.embedding, s.ids, ALL)
        semantic = semantic_loss(s.embedding, s.ids)
        offset = offset_loss(s.embedding[..., :3], s.points.bfloat16(), s.ids)
    assert value.dtype == got_confidence.dtype == semantic.dtype == offset.dtype == torch.float32
    assert gradient.dtype == torch.bfloat16
    torch.testing.assert_close((value, got_confidence), (want, want_confidence), rtol=0, atol=0)
    torch.testing.assert_close(gradient, want_gradient.bfloat16(), rtol=0, atol=0)
    torch.testing.assert_close(semantic, semantic_loss(s.embedding.float(), s.ids))
    torch.testing.assert_close(offset, offset_loss(s.embedding[..., :3].float(), s.points.bfloat16().float(), s.ids))
