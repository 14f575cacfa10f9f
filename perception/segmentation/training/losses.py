"""The terms of the training loss: pairs in the embedding, confidence, semantics, offsets.

Every term is a mean over the points (or pairs of points) of a cloud, then over the clouds that have any: one batch of
four counts like four batches of one. Points of instance -1 (the container) take no part in any term.

Shapes: B clouds, N points, F dimensions of the embedding, S semantic classes, A anchors, R anchors of one block.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, cast, get_args

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from perception.segmentation.networks.distance import SQUARE_SCALE, Distance, squared_threshold
from perception.segmentation.training.anchors import draw_anchors, group_sizes

Kind = Literal["double_hinge", "focal_double_hinge"]
Weighting = Literal["none", "inverse_frequency"]
Rise = Literal["linear", "stepped", "constant"]
_Cases = tuple[Tensor, Tensor | None, Tensor | None]

COINCIDENT = 1e-5  # embedding distance below which the gradient of ||df|| fades to 0; float64 resolves it
BLOCK_ELEMENTS = {"cpu": 1 << 20, "cuda": 1 << 24}  # pairs at once: within a CPU's cache, within a GPU's memory


@dataclass(frozen=True, kw_only=True)
class PairLossConfig:
    """Equation and constants of the pair loss (section IV of the paper)."""

    kind: Kind = "focal_double_hinge"  # eq. (2), or eq. (1) for SGPN's double hinge
    distance: Distance = "l2"  # D of the equations: ||df||_2 as printed, or 10 ||df||^2 as in SGPN's code
    same: float = 5.0  # M1: distance below which pairs of one instance cost nothing; the double hinge ignores it
    other: float = 10.0  # M2 (K1): distance above which pairs of two instances of a class cost nothing
    category: float = 80.0  # M3 (K2): distance above which pairs of two classes cost nothing
    beta: float = 2.0  # weight of pairs of one instance in eq. (2)
    anchors: int | None = 256  # number of points per cloud whose pairs are computed; None for all
    reach: float | None = None  # distance in space, in the unit of the points, from which on case 2 costs nothing
    weighting: Weighting = "none"  # weight of a pair: 1, or w_i w_j with w = points of the cloud / of the instance

    def __post_init__(self) -> None:
        _require_choice("kind", self.kind, Kind)
        _require_choice("distance", self.distance, Distance)
        _require_choice("weighting", self.weighting, Weighting)
        if not 0 < self.same < self.other < self.category:
            raise ValueError(f"margins must be 0 < same < other < category, got {self.same, self.other, self.category}")
        if not self.beta > 0:
            raise ValueError(f"beta must be positive, got {self.beta}")
        if self.anchors is not None and self.anchors < 1:
            raise ValueError(f"anchors must be at least 1, or None for all pairs, got {self.anchors}")
        if self.reach is not None and not self.reach > 0:
            raise ValueError(f"reach must be positive, or None for any, got {self.reach}")

    @property
    def threshold(self) -> float:
        """Distance below which two points are similar, K1 as in SGPN or the mean of M1 and M2."""
        return self.other if self.kind == "double_hinge" else (self.same + self.other) / 2


@dataclass(frozen=True, kw_only=True)
class AlphaSchedule:
    """Weight alpha of pairs of two instances: it rises by ``step`` every ``every`` epochs up to ``limit``."""

    kind: Rise = "linear"  # linear as in SGPN's code, stepped as in the paper's text, or constant
    start: float = 2.0  # alpha of epoch 0
    step: float = 2.0  # increase of alpha
    every: float = 5.0  # number of epochs between increases
    limit: float = 10.0  # largest alpha

    def __post_init__(self) -> None:
        _require_choice("kind", self.kind, Rise)
        if not 0 < self.start <= self.limit:
            raise ValueError(f"alpha must start above 0 and not above its limit, got {self.start} and {self.limit}")
        if not (self.step >= 0 and self.every > 0):
            raise ValueError(f"alpha must rise by 0 or more every so many epochs, got {self.step} every {self.every}")

    def __call__(self, epoch: float) -> float:
        """Return alpha at an epoch, which counts from 0 and may be fractional.

        Raises:
            ValueError: ``epoch`` is negative.
        """
        if not epoch >= 0:
            raise ValueError(f"epoch must not be negative, got {epoch}")
        if self.kind == "constant":
            return self.start
        rises = epoch / self.every if self.kind == "linear" else epoch // self.every
        return min(self.limit, self.start + self.step * rises)


class PointAttributes(NamedTuple):
    """What the pair loss knows of the points besides their instances.

    Attributes:
        class_ids_BN: Class of each point, -1 for unknown, which is left out like void; None for a single class.
        points_BN3: Coordinates of the points in the unit of ``PairLossConfig.reach``, which needs them.
    """

    class_ids_BN: Tensor | None = None
    points_BN3: Tensor | None = None


def pair_loss(
    embedding_BNF: Tensor,
    instance_ids_BN: Tensor,
    config: PairLossConfig,
    alpha: float,
    *,
    attributes: PointAttributes | None = None,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Return L_SIM, eq. (1) or (2) of the paper, as a mean over the ordered pairs of points, (i, i) included.

    Differs from SGPN's code: pairs of two classes are case 3 even with one instance id. Inverse frequencies are counted
    per cloud; in a batch, instances of different clouds have the same ids.

    Args:
        embedding_BNF: Embedding F_SIM in any floating type; half precisions are computed in float32.
        instance_ids_BN: Instance of each point, -1 for void.
        config: Equation and constants.
        alpha: Weight of pairs of two instances of a class.
        attributes: Classes and coordinates of the points; None for a single class.
        generator: Source of the anchors' draws; None for torch's own.

    Returns:
        A scalar. With anchors, the expectations of its value and its gradient over the draws are those of all pairs.

    Raises:
        ValueError: Shapes do not agree, ``alpha`` is not positive, or ``config.reach`` has no points to measure.

    Note:
        It computes anchors x N pairs in blocks, so memory does not grow with the anchors. There are no second
        derivatives.
    """
    ids_BN = _require_inputs(embedding_BNF, instance_ids_BN)
    class_ids_BN, points_BN3 = attributes or PointAttributes()
    if not alpha > 0:
        raise ValueError(f"alpha must be positive, got {alpha}")
    if config.reach is not None and points_BN3 is None:
        raise ValueError(f"reach={config.reach} needs points_BN3, got None")
    _require_shape("class_ids_BN", class_ids_BN, tuple(ids_BN.shape))
    _require_shape("points_BN3", points_BN3, (*ids_BN.shape, 3))
    if class_ids_BN is not None:
        ids_BN = ids_BN.masked_fill(class_ids_BN < 0, -1)
    weight_BN = (ids_BN >= 0).double()
    count_B1 = weight_BN.sum(1, keepdim=True)
    anchors_BA, anchor_weight_BA = draw_anchors(ids_BN, config.anchors, generator)
    if config.weighting == "inverse_frequency":
        weight_BN *= count_B1 / group_sizes(ids_BN)
    row_BA = anchor_weight_BA * weight_BN.gather(1, anchors_BA) * _per_cloud(count_B1) / count_B1.clamp_min(1)
    pairs = _Pairs(anchors_BA, row_BA, weight_BN, ids_BN, class_ids_BN, points_BN3)
    with torch.autocast(embedding_BNF.device.type, enabled=False):  # it would round products of float32 to bfloat16
        return cast(Tensor, _PairSum.apply(_exact(embedding_BNF), pairs, config, alpha))  # type: ignore[no-untyped-call]


def confidence_loss(
    confidence_BN: Tensor,
    embedding_BNF: Tensor,
    instance_ids_BN: Tensor,
    config: PairLossConfig,
    *,
    threshold: float | None = None,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Return L_CF: mean squared difference between the confidence of a point and the IoU of the group it proposes.

    The group that point i proposes is {j: D_ij < threshold}. Its IoU with the instance of i is a target without
    gradient.

    Args:
        confidence_BN: Confidence of each point in (0, 1).
        embedding_BNF: Embedding F_SIM in any floating type.
        instance_ids_BN: Instance of each point, -1 for void, which no point proposes.
        config: Distance D, and the number of anchors per cloud whose IoU is computed, without bias.
        threshold: Largest distance D in a proposal; None for ``config.threshold``.
        generator: Source of the anchors' draws; None for torch's own.

    Raises:
        ValueError: Shapes do not agree, or the threshold is not positive.
    """
    ids_BN = _require_inputs(embedding_BNF, instance_ids_BN)
    _require_shape("confidence_BN", confidence_BN, tuple(ids_BN.shape))
    threshold = config.threshold if threshold is None else threshold
    if not threshold > 0:
        raise ValueError(f"threshold must be positive, got {threshold}")
    limit = squared_threshold(threshold, config.distance)
    anchors_BA, weight_BA = draw_anchors(ids_BN, config.anchors, generator)
    iou_BA = _proposal_iou(embedding_BNF.detach(), ids_BN, anchors_BA, limit)
    confidence_BA = _exact(confidence_BN).gather(1, anchors_BA)
    weight_BA = weight_BA * _per_cloud((ids_BN >= 0).sum(1, keepdim=True))
    return (weight_BA.to(confidence_BA.dtype) * (confidence_BA - iou_BA.to(confidence_BA.dtype)) ** 2).sum()


def semantic_loss(semantics_BNS: Tensor, class_ids_BN: Tensor) -> Tensor:
    """Return L_SEM, the cross entropy of the (B, N, S) logits, where class -1 is void; with S = 1 it is 0."""
    _require_shape("semantics_BNS", semantics_BNS, (*class_ids_BN.shape, semantics_BNS.shape[-1]))
    logits_BSN = _exact(semantics_BNS).mT
    entropy_BN = functional.cross_entropy(logits_BSN, class_ids_BN.long(), ignore_index=-1, reduction="none")
    return _mean(entropy_BN, class_ids_BN >= 0)


def offset_loss(offsets_BN3: Tensor, targets_BN3: Tensor, instance_ids_BN: Tensor, delta: float = 0.1) -> Tensor:
    """Return the Huber loss of the offsets to the centre of the part, summed over the coordinates.

    Args:
        offsets_BN3: Predicted offsets in units of d_max.
        targets_BN3: True offsets in units of d_max; those of void points are ignored.
        instance_ids_BN: Instance of each point, -1 for void.
        delta: Error above which the loss grows linearly, with slope ``delta``.

    Raises:
        ValueError: Shapes do not agree, or ``delta`` is not positive.
    """
    _require_shape("offsets_BN3", offsets_BN3, (*instance_ids_BN.shape, 3))
    _require_shape("targets_BN3", targets_BN3, (*instance_ids_BN.shape, 3))
    if not delta > 0:
        raise ValueError(f"delta must be positive, got {delta}")
    valid_BN = instance_ids_BN >= 0
    offsets_BN3 = _exact(offsets_BN3)
    # Void targets are replaced before the Huber loss: a NaN would reach the gradient through a later mask.
    targets_BN3 = torch.where(valid_BN[..., None], targets_BN3.to(offsets_BN3.dtype), offsets_BN3.detach())
    return _mean(functional.huber_loss(offsets_BN3, targets_BN3, reduction="none", delta=delta).sum(-1), valid_BN)


class _Pairs(NamedTuple):
    """Pairs of every anchor with every point; a pair's weight is ``row_BA[a] * column_BN[j]``."""

    anchors_BA: Tensor
    row_BA: Tensor
    column_BN: Tensor
    ids_BN: Tensor
    class_ids_BN: Tensor | None
    points_BN3: Tensor | None


class _PairSum(torch.autograd.Function):
    """Weighted sum of l(i, j), whose gradient the forward pass computes in closed form.

    With g_aj = dl/d|f_a - f_j|^2 times both weights, the gradient by f_a is 2 (f_a sum_j g_aj - sum_j g_aj f_j), and
    likewise by f_j. Weighted features with their weight appended give both sums in one product.
    """

    @staticmethod
    def forward(ctx: Any, embedding_BNF: Tensor, pairs: _Pairs, config: PairLossConfig, alpha: float) -> Tensor:
        exact_BNF, column_BN1 = embedding_BNF.double(), pairs.column_BN[..., None]
        weighted_BNG = torch.cat([exact_BNF * column_BN1, column_BN1], 2)
        total = exact_BNF.new_zeros(())
        gradient_BNF, by_point_BGN = torch.zeros_like(exact_BNF), torch.zeros_like(weighted_BNG.mT)
        for rows in _blocks(pairs.anchors_BA, embedding_BNF.shape[1]):
            index_BR, row_BR1 = pairs.anchors_BA[:, rows], pairs.row_BA[:, rows, None]
            anchor_BRF = _take(exact_BNF, index_BR)
            square_BRN = _squared_distances(anchor_BRF, exact_BNF).to(embedding_BNF.dtype)
            loss_BRN, slope_BRN = _case_terms(square_BRN, _cases(pairs, index_BR, config), config, alpha)
            total += (row_BR1 * (loss_BRN @ column_BN1.to(loss_BRN.dtype))).sum()
            if ctx.needs_input_grad[0]:
                slope_BRN = slope_BRN.double()
                by_anchor_BRG = slope_BRN @ weighted_BNG
                by_point_BGN += torch.cat([anchor_BRF * row_BR1, row_BR1], 2).mT @ slope_BRN
                anchor_gradient_BRF = 2 * row_BR1 * (anchor_BRF * by_anchor_BRG[..., -1:] - by_anchor_BRG[..., :-1])
                gradient_BNF.scatter_add_(1, index_BR[..., None].expand_as(anchor_BRF), anchor_gradient_BRF)
        gradient_BNF += 2 * column_BN1 * (exact_BNF * by_point_BGN[:, -1:].mT - by_point_BGN[:, :-1].mT)
        ctx.save_for_backward(gradient_BNF.to(embedding_BNF.dtype))
        return total.to(embedding_BNF.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, outer: Tensor) -> tuple[Tensor, None, None, None]:
        (gradient_BNF,) = ctx.saved_tensors
        return outer * gradient_BNF, None, None, None


def _cases(pairs: _Pairs, index_BR: Tensor, config: PairLossConfig) -> _Cases:
    """Return masks of the pairs of one instance, of two classes, and of case 2 out of reach; None if impossible."""
    same_BRN = pairs.ids_BN.gather(1, index_BR)[..., None] == pairs.ids_BN[:, None]
    differs_BRN = free_BRN = None
    if pairs.class_ids_BN is not None:
        differs_BRN = pairs.class_ids_BN.gather(1, index_BR)[..., None] != pairs.class_ids_BN[:, None]
    if pairs.points_BN3 is not None and config.reach is not None:
        points_BN3 = pairs.points_BN3.double()
        square_BRN = _squared_distances(_take(points_BN3, index_BR), points_BN3)
        free_BRN = (square_BRN >= config.reach**2) & ~same_BRN
        if differs_BRN is not None:
            free_BRN &= ~differs_BRN
    return same_BRN, differs_BRN, free_BRN


def _case_terms(square_BRN: Tensor, cases: _Cases, config: PairLossConfig, alpha: float) -> tuple[Tensor, Tensor]:
    """Return l(i, j) of eq. (1) or (2) and its derivative by the squared distance."""
    same_BRN, differs_BRN, free_BRN = cases
    gain, margin = (config.beta, config.same) if config.kind == "focal_double_hinge" else (1.0, 0.0)
    distance_BRN = square_BRN.sqrt() if config.distance == "l2" else square_BRN * SQUARE_SCALE
    pull_BRN = (distance_BRN - margin).mul_(gain)
    push_BRN = (config.other - distance_BRN).mul_(alpha)
    loss_BRN = torch.where(same_BRN, pull_BRN, push_BRN)
    slope_BRN = torch.where(same_BRN, loss_BRN.new_tensor(gain), loss_BRN.new_tensor(-alpha))
    if differs_BRN is not None:
        loss_BRN = torch.where(differs_BRN, config.category - distance_BRN, loss_BRN)
        slope_BRN.masked_fill_(differs_BRN, -1.0)
    if free_BRN is not None:
        loss_BRN.masked_fill_(free_BRN, 0.0)
    slope_BRN.masked_fill_(loss_BRN <= 0, 0.0)
    if config.distance == "l2":
        slope_BRN /= distance_BRN.clamp_min_(COINCIDENT).mul_(2.0)
    else:
        slope_BRN *= SQUARE_SCALE
    return loss_BRN.clamp_min_(0.0), slope_BRN


def _proposal_iou(embedding_BNF: Tensor, ids_BN: Tensor, anchors_BA: Tensor, limit: float) -> Tensor:
    """Return (B, A) IoU between the points within ``limit`` (squared) of each anchor and the anchor's instance."""
    exact_BNF, valid_BN, sizes_BN = embedding_BNF.double(), ids_BN >= 0, group_sizes(ids_BN).double()
    iou_BA = exact_BNF.new_zeros(anchors_BA.shape)
    for rows in _blocks(anchors_BA, ids_BN.shape[1]):
        index_BR = anchors_BA[:, rows]
        near_BRN = (_squared_distances(_take(exact_BNF, index_BR), exact_BNF) < limit) & valid_BN[:, None]
        same_BRN = ids_BN.gather(1, index_BR)[..., None] == ids_BN[:, None]
        proposed_BR = near_BRN.sum(2)
        shared_BR = same_BRN.logical_and_(near_BRN).sum(2)
        iou_BA[:, rows] = shared_BR / (proposed_BR + sizes_BN.gather(1, index_BR) - shared_BR)
    return iou_BA


def _squared_distances(anchor_BRC: Tensor, points_BNC: Tensor) -> Tensor:
    """Return the (B, R, N) squared distances. The expansion cancels for near pairs, so inputs must be float64."""
    norms_BR1, norms_B1N = anchor_BRC.square().sum(2)[..., None], points_BNC.square().sum(2)[:, None]
    return torch.baddbmm(norms_B1N, anchor_BRC, points_BNC.mT, alpha=-2).add_(norms_BR1).clamp_min_(0)


def _blocks(anchors_BA: Tensor, points: int) -> Iterator[slice]:
    clouds, anchors = anchors_BA.shape
    size = max(1, BLOCK_ELEMENTS["cuda" if anchors_BA.is_cuda else "cpu"] // max(1, clouds * points))
    return (slice(start, start + size) for start in range(0, anchors, size))


def _exact(values: Tensor) -> Tensor:
    """Return half precision as float32; other types are unchanged."""
    return values.to(torch.promote_types(values.dtype, torch.float32))


def _take(values_BNC: Tensor, index_BR: Tensor) -> Tensor:
    return values_BNC.gather(1, index_BR[..., None].expand(-1, -1, values_BNC.shape[2]))


def _per_cloud(count_B1: Tensor) -> Tensor:
    """Return weights that turn sums over points into means over points, then over the clouds that have points."""
    filled_B1 = count_B1 > 0
    return filled_B1 / (count_B1.clamp_min(1) * filled_B1.sum().clamp_min(1)).double()


def _mean(values_BN: Tensor, valid_BN: Tensor) -> Tensor:
    weight_BN = valid_BN * _per_cloud(valid_BN.sum(1, keepdim=True))
    return (values_BN * weight_BN.to(values_BN.dtype)).sum()


def _require_inputs(embedding_BNF: Tensor, instance_ids_BN: Tensor) -> Tensor:
    if embedding_BNF.ndim != 3:
        raise ValueError(f"embedding_BNF must be (B, N, F), got {tuple(embedding_BNF.shape)}")
    _require_shape("instance_ids_BN", instance_ids_BN, tuple(embedding_BNF.shape[:2]))
    return instance_ids_BN.long()


def _require_shape(name: str, tensor: Tensor | None, shape: tuple[int, ...]) -> None:
    if tensor is not None and tuple(tensor.shape) != shape:
        raise ValueError(f"{name} must be {shape}, got {tuple(tensor.shape)}")


def _require_choice(name: str, value: str, choices: Any) -> None:
    if value not in get_args(choices):
        raise ValueError(f"{name} must be one of {', '.join(get_args(choices))}, got {value!r}")
