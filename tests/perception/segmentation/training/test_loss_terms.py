"""Confidence, semantics, offsets; the schedule of alpha; what is refused."""

import math
import re
from dataclasses import replace

import pytest
import torch

from perception.segmentation.training.losses import (
    AlphaSchedule,
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
    TWIN,
    in_reading,
    on_a_line,
    scene,
    value_and_gradient,
)

# Confidence, semantics, offsets


def test_confidence_of_four_points_by_hand():
    # Instances {0, 1}, {2}, void 3; threshold 7.5: 0 proposes {0, 1}, 1 {0, 1, 2}, 2 {1, 2}: IoU 1, 2/3, 1/2.
    embedding, confidence = on_a_line(0, 7, 7.6, 7.2), torch.tensor([[0.5, 0.5, 0.25, 0.5]]).double()
    ids = torch.tensor([[0, 0, 1, -1]])
    value, gradient = value_and_gradient(confidence, embedding, ids, ALL, loss=confidence_loss)
    assert value.item() == pytest.approx((1 / 4 + 1 / 36 + 1 / 16) / 3)
    by_hand = torch.tensor([[-1.0, -1 / 3, -1 / 2, 0.0]]).double() / 3
    torch.testing.assert_close(gradient, by_hand)
    assert embedding.grad is None  # the IoU is a target


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("threshold", [None, 6.0])
def test_confidence_is_its_twin(kind, distance, threshold):
    config = PairLossConfig(kind=kind, distance=distance, anchors=None)
    s = scene(13)
    embedding = in_reading(config, s.embedding)
    at = threshold or {"double_hinge": 10.0, "focal_double_hinge": 7.5}[kind]
    want = TWIN.confidence_loss(s.confidence.tolist(), embedding.tolist(), s.ids.tolist(), config, at)
    for anchors in (None, 14):
        got = confidence_loss(s.confidence, embedding, s.ids, replace(config, anchors=anchors), threshold=threshold)
        assert got.item() == pytest.approx(want, rel=1e-12)


def test_semantics():
    logits = torch.zeros(1, 3, 4)
    assert semantic_loss(logits, torch.tensor([[0, 3, -1]])).item() == pytest.approx(math.log(4))
    s = scene(14)
    classes = torch.where(s.ids < 0, -1, s.classes)
    want = TWIN.semantic_loss(s.embedding.tolist(), classes.tolist())
    assert semantic_loss(s.embedding, classes).item() == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("classes", [[[0, 0]], [[-1, -1]]])
def test_semantics_of_a_single_class_or_of_void_alone_are_zero(classes):
    classes = torch.tensor(classes)
    logits = torch.randn(1, 2, 1 if classes.max() == 0 else 3)
    value, gradient = value_and_gradient(logits, classes, loss=semantic_loss)
    assert value == 0
    assert (gradient == 0).all()


def test_offsets_by_hand_and_twin():
    # Errors 0.05 (quadratic, 0.05^2 / 2), 0.3 (linear, 0.1 (0.3 - 0.05)) and 0; the void point's target is unknown.
    offsets = torch.tensor([[[0.05, -0.3, 0.0], [1.0, 1.0, 1.0]]])
    targets = torch.tensor([[[0.0] * 3, [math.nan] * 3]])
    value, gradient = value_and_gradient(offsets, targets, torch.tensor([[0, -1]]), loss=offset_loss)
    assert value.item() == pytest.approx(0.00125 + 0.025)
    torch.testing.assert_close(gradient, torch.tensor([[[0.05, -0.1, 0.0], [0.0, 0.0, 0.0]]]))
    s = scene(15)
    offsets = s.embedding[..., :3] / 8
    want = TWIN.offset_loss(offsets.tolist(), s.points.tolist(), s.ids.tolist(), 0.4)
    assert offset_loss(offsets, s.points, s.ids, delta=0.4).item() == pytest.approx(want, rel=1e-12)
    assert offset_loss(offsets, s.points, torch.full_like(s.ids, -1)) == 0


# Schedule and errors


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        ("linear", {0: 2.0, 1: 2.4, 2.5: 3.0, 10: 6.0, 19: 9.6, 20: 10.0, 200: 10.0}),
        ("stepped", {0: 2.0, 4.99: 2.0, 5: 4.0, 9: 4.0, 10: 6.0, 15: 8.0, 20: 10.0, 25: 10.0, 200: 10.0}),
        ("constant", {0: 2.0, 7: 2.0, 200: 2.0}),
    ],
)
def test_alpha_schedule(kind, table):
    schedule = AlphaSchedule(kind=kind)
    assert {epoch: schedule(epoch) for epoch in table} == pytest.approx(table)


def test_alpha_schedule_takes_its_constants():
    assert AlphaSchedule(start=1.0, step=3.0, every=2.0, limit=50.0)(4) == pytest.approx(7.0)
    assert AlphaSchedule(kind="constant", start=4.0)(9) == 4.0


def test_thresholds():
    assert PairLossConfig(kind="double_hinge").threshold == 10.0
    assert PairLossConfig(same=4.0, other=12.0).threshold == 8.0


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"kind": "hinge"}, "kind must be one of double_hinge, focal_double_hinge, got 'hinge'"),
        ({"distance": "l1"}, "distance must be one of l2, scaled_square, got 'l1'"),
        ({"weighting": "size"}, "weighting must be one of none, inverse_frequency, got 'size'"),
        ({"same": 0.0}, "margins must be 0 < same < other < category, got (0.0, 10.0, 80.0)"),
        ({"same": 10.0}, "got (10.0, 10.0, 80.0)"),
        ({"category": 9.0}, "got (5.0, 10.0, 9.0)"),
        ({"beta": 0.0}, "beta must be positive, got 0.0"),
        ({"beta": math.nan}, "beta must be positive, got nan"),
        ({"anchors": 0}, "anchors must be at least 1, or None for all pairs, got 0"),
        ({"reach": 0.0}, "reach must be positive, or None for any, got 0.0"),
    ],
)
def test_pair_loss_config_rejects(fields, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        PairLossConfig(**fields)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"kind": "cosine"}, "kind must be one of linear, stepped, constant, got 'cosine'"),
        ({"start": 0.0}, "alpha must start above 0 and not above its limit, got 0.0 and 10.0"),
        ({"limit": 1.0}, "got 2.0 and 1.0"),
        ({"step": -1.0}, "alpha must rise by 0 or more every so many epochs, got -1.0 every 5.0"),
        ({"every": 0.0}, "got 2.0 every 0.0"),
    ],
)
def test_alpha_schedule_rejects(fields, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        AlphaSchedule(**fields)


E = torch.zeros(2, 5, 3)
IDS = torch.zeros(2, 5, dtype=torch.int64)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: AlphaSchedule()(-1), "epoch must not be negative, got -1"),
        (lambda: pair_loss(E[0], IDS[0], ALL, 2.0), "embedding_BNF must be (B, N, F), got (5, 3)"),
        (lambda: pair_loss(E, IDS[:1], ALL, 2.0), "instance_ids_BN must be (2, 5), got (1, 5)"),
        (lambda: pair_loss(E, IDS, ALL, 0.0), "alpha must be positive, got 0.0"),
        (lambda: pair_loss(E, IDS, replace(ALL, reach=1.0), 2.0), "reach=1.0 needs points_BN3, got None"),
        (
            lambda: pair_loss(E, IDS, ALL, 2.0, attributes=PointAttributes(IDS[:, :2])),
            "class_ids_BN must be (2, 5), got (2, 2)",
        ),
        (
            lambda: pair_loss(E, IDS, ALL, 2.0, attributes=PointAttributes(points_BN3=E[..., :2])),
            "points_BN3 must be (2, 5, 3), got (2, 5, 2)",
        ),
        (lambda: confidence_loss(E, E, IDS, ALL), "confidence_BN must be (2, 5), got (2, 5, 3)"),
        (lambda: confidence_loss(E[..., 0], E, IDS, ALL, threshold=0.0), "threshold must be positive, got 0.0"),
        (lambda: semantic_loss(E[:1], IDS), "semantics_BNS must be (2, 5, 3), got (1, 5, 3)"),
        (lambda: offset_loss(E[..., :2], E, IDS), "offsets_BN3 must be (2, 5, 3), got (2, 5, 2)"),
        (lambda: offset_loss(E, E[:1], IDS), "targets_BN3 must be (2, 5, 3), got (1, 5, 3)"),
        (lambda: offset_loss(E, E, IDS, delta=0.0), "delta must be positive, got 0.0"),
    ],
)
def test_calls_are_checked(call, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        call()
