"""Anchors of a training loss: the points of a cloud whose pairs are computed, drawn without bias.

Shapes: B clouds, N points, A anchors.
"""

import torch
from torch import Tensor


def draw_anchors(ids_BN: Tensor, anchors: int | None, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
    """Draw anchors, such that sums over the weighted anchors have the sums over all points as their expectation.

    The anchors are a systematic sample of the points, which are sorted by instance and shuffled within each. So the
    sample is stratified, and a point is drawn with exactly its probability. Its weight is the inverse of that.

    Args:
        ids_BN: Instance of each point, -1 for void.
        anchors: Number of anchors of each cloud; None for all points.
        generator: Source of the draws; None for torch's own.

    Returns:
        (B, A) index of each anchor, and its (B, A) weight, 0 for a place that stays empty.
    """
    clouds, points = ids_BN.shape
    if anchors is None:
        return torch.arange(points, device=ids_BN.device).expand(clouds, -1), (ids_BN >= 0).double()
    device = ids_BN.device if generator is None else generator.device
    drawn = torch.rand((clouds, points + 1), dtype=torch.float64, generator=generator, device=device).to(ids_BN.device)
    order_BN = torch.where(ids_BN >= 0, ids_BN + drawn[:, 1:], torch.inf).argsort(1)
    return systematic_sample(anchor_probability(ids_BN, anchors), order_BN, drawn[:, :1], min(anchors, points))


def anchor_probability(ids_BN: Tensor, anchors: int) -> Tensor:
    """Return each point's probability of being an anchor.

    Each instance expects one anchor, and the other anchors are shared out in proportion to its size. With fewer anchors
    than instances, all instances are equally probable. With fewer points than anchors, every point is an anchor.
    """
    valid_BN, sizes_BN = ids_BN >= 0, group_sizes(ids_BN).double()
    count_B1 = valid_BN.sum(1, keepdim=True)
    groups_B1 = (valid_BN / sizes_BN).sum(1, keepdim=True).round()
    drawn_B1 = count_B1.clamp_max(anchors).double()
    first_B1 = (drawn_B1 / groups_B1.clamp_min(1)).clamp_max(1)
    rest_BN = (drawn_B1 - groups_B1).clamp_min(0) * (sizes_BN - 1) / (count_B1 - groups_B1).clamp_min(1)
    return valid_BN * (first_B1 + rest_BN) / sizes_BN


def systematic_sample(probability_BN: Tensor, order_BN: Tensor, start_B1: Tensor, places: int) -> tuple[Tensor, Tensor]:
    """Return the (B, A) points whose intervals of cumulative probability contain ``start + k``, and their weights."""
    bounds_BN = probability_BN.gather(1, order_BN).cumsum(1)
    marks_BA = start_B1 + torch.arange(places, device=order_BN.device)
    position_BA = torch.searchsorted(bounds_BN, marks_BA, right=True)
    found_BA = position_BA < order_BN.shape[1]
    index_BA = order_BN.gather(1, position_BA.clamp_max(order_BN.shape[1] - 1))
    return index_BA, torch.where(found_BA, 1 / probability_BN.gather(1, index_BA), 0.0)


def group_sizes(ids_BN: Tensor) -> Tensor:
    """Return the number of points of the cloud that share each point's instance."""
    sorted_BN, ids_BN = ids_BN.sort(1).values, ids_BN.contiguous()
    return torch.searchsorted(sorted_BN, ids_BN, right=True) - torch.searchsorted(sorted_BN, ids_BN)
