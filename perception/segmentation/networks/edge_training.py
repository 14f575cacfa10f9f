"""The layers of an EdgeConv in training on a CPU, with few passes over the edges.

Normalisation and ReLU are monotonic in each channel, so the maximum over the edges of a point is that of one of its
sums. Only that one is normalised. Sums of the first layer are computed where they are needed and not stored. The result
is that of the plain layers, to rounding.

Shapes: B clouds, N points, K neighbours, C channels.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from perception.segmentation.networks import _edge_kernels as _kernels

Reals = NDArray[np.floating]


class NormSettings(NamedTuple):
    """What a layer needs besides its sums and the weight and the bias of its normalisation.

    Attributes:
        eps: Number added to the variance.
        slope: Slope of the ReLU below 0.
        neighbours_BNK: Neighbours of each point.
    """

    eps: float
    slope: float
    neighbours_BNK: Tensor


class Normalised(NamedTuple):
    """Mean and variance of the sums of a layer over all edges, each (C,), for its running statistics."""

    mean: Tensor
    variance: Tensor


def activated_sums(
    there_BNC: Tensor, here_BNC: Tensor, neighbours_BNK: Tensor, norm: nn.BatchNorm2d, slope: float
) -> Tensor:
    """Return the (B, N, K, C) normalised activations of the sums ``there[j] + here[i]`` over the edges (i, j)."""
    return _of_sums(_ActivatedSums, there_BNC, here_BNC, NormSettings(norm.eps, slope, neighbours_BNK), norm)


def largest_activation(sums_BNKC: Tensor, norm: nn.BatchNorm2d, slope: float) -> Tensor:
    """Return the (B, N, C) maxima over the edges of a point of the normalised activations of sums."""
    batch, count, k, channels = sums_BNKC.shape
    rows_BEC = sums_BNKC.to(norm.weight.dtype).flatten(1, 2)
    # Each edge is a neighbour of its own, and the point adds nothing.
    edges_BNK = torch.arange(count * k).view(count, k).expand(batch, count, k)
    return largest_sum_activation(rows_BEC, rows_BEC.new_zeros(batch, count, channels), edges_BNK, norm, slope)


def largest_sum_activation(
    there_BNC: Tensor, here_BNC: Tensor, neighbours_BNK: Tensor, norm: nn.BatchNorm2d, slope: float
) -> Tensor:
    """Return the (B, N, C) maxima of :func:`activated_sums` over the edges of a point, which are not stored."""
    return _of_sums(_LargestSum, there_BNC, here_BNC, NormSettings(norm.eps, slope, neighbours_BNK), norm)


def _of_sums(
    layer: type[torch.autograd.Function], there: Tensor, here: Tensor, settings: NormSettings, norm: nn.BatchNorm2d
) -> Tensor:
    """Return what a layer gives for sums that are not stored, and update the running statistics."""
    out, mean, variance = layer.apply(there, here, norm.weight, norm.bias, settings)  # type: ignore[no-untyped-call]
    _keep_statistics(norm, Normalised(mean, variance), settings.neighbours_BNK.numel())
    return cast(Tensor, out)


class _ActivatedSums(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, there: Tensor, here: Tensor, weight: Tensor, bias: Tensor, settings: NormSettings
    ) -> tuple[Tensor, Tensor, Tensor]:
        neighbours = settings.neighbours_BNK
        arrays = _clouds(there, here, neighbours)
        total = np.sum(_each(_kernels.sum_statistics, arrays), axis=0)
        norm = _Norm.of(total, neighbours.numel(), weight, bias, settings)
        out = np.empty((*neighbours.shape, there.shape[2]), norm.scale.dtype)
        _each(_kernels.activated_sums, [(*cloud, *norm.line, o) for cloud, o in zip(arrays, out, strict=True)])
        ctx.save_for_backward(there, here)
        ctx.norm = norm
        return (torch.from_numpy(out), *norm.statistics())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        there, here = ctx.saved_tensors
        norm = ctx.norm
        arrays = _clouds(there, here, norm.settings.neighbours_BNK)
        given = gradient.contiguous().numpy()
        totals = _each(
            _kernels.activation_totals, [(*cloud, *norm.line, g) for cloud, g in zip(arrays, given, strict=True)]
        )
        factors, by_weight, by_bias = norm.gradients(np.sum(totals, axis=0))
        by_there, by_here = np.zeros(there.shape, given.dtype), np.zeros(here.shape, given.dtype)
        rows = zip(arrays, given, by_there, by_here, strict=True)
        _each(_kernels.sum_gradients, [(*cloud, *norm.line, factors, g, a, b) for cloud, g, a, b in rows])
        return torch.from_numpy(by_there), torch.from_numpy(by_here), by_weight, by_bias, None


class _LargestSum(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, there: Tensor, here: Tensor, weight: Tensor, bias: Tensor, settings: NormSettings
    ) -> tuple[Tensor, Tensor, Tensor]:
        neighbours = settings.neighbours_BNK
        arrays, signs = _clouds(there, here, neighbours), _signs(weight)
        largest, which = np.empty(here.shape, signs.dtype), np.empty(here.shape, np.int64)
        rows = zip(arrays, largest, which, strict=True)
        total = np.sum(_each(_kernels.sum_extremes, [(*cloud, signs, m, w) for cloud, m, w in rows]), axis=0)
        norm = _Norm.of(total, neighbours.numel(), weight, bias, settings)
        ctx.save_for_backward(there, here)
        ctx.norm, ctx.largest, ctx.which = norm, largest, which
        return (torch.from_numpy(norm.activated(largest)), *norm.statistics())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
        there, here = ctx.saved_tensors
        through, total = ctx.norm.through(gradient, ctx.largest)
        factors, by_weight, by_bias = ctx.norm.gradients(total)
        by_there, by_here = np.zeros(there.shape, through.dtype), np.zeros(here.shape, through.dtype)
        rows = zip(
            _clouds(there, here, ctx.norm.settings.neighbours_BNK), through, ctx.which, by_there, by_here, strict=True
        )
        _each(_kernels.extreme_gradients, [(*cloud, factors, t, w, a, b) for cloud, t, w, a, b in rows])
        return torch.from_numpy(by_there), torch.from_numpy(by_here), by_weight, by_bias, None


class _Norm(NamedTuple):
    """Normalisation of a layer over M edges, as factor and summand of its sums, and the ReLU after it."""

    mean: Reals
    variance: Reals
    weight: Reals
    scale: Reals
    shift: Reals
    settings: NormSettings
    edges: int

    @classmethod
    def of(cls, total: Reals, edges: int, weight: Tensor, bias: Tensor, settings: NormSettings) -> "_Norm":
        mean = total[0] / edges
        variance = np.maximum(total[1] / edges - mean * mean, 0.0)
        factor, dtype = weight.detach().numpy().astype(np.float64), weight.detach().numpy().dtype
        scale = factor / np.sqrt(variance + settings.eps)
        shift = bias.detach().numpy() - mean * scale
        return cls(mean, variance, factor, scale.astype(dtype), shift.astype(dtype), settings, edges)

    @property
    def line(self) -> tuple[Reals, Reals, Any]:
        """Factor, summand and slope, in the type of the sums."""
        return self.scale, self.shift, self.scale.dtype.type(self.settings.slope)

    def statistics(self) -> tuple[Tensor, Tensor]:
        return torch.from_numpy(self.mean), torch.from_numpy(self.variance)

    def activated(self, sums: Reals) -> Reals:
        values = sums * self.scale + self.shift
        return np.where(values > 0, values, values * self.line[2])

    def through(self, gradient: Tensor, largest: Reals) -> tuple[Reals, Reals]:
        """Return the gradient behind the ReLU by the largest sums, and the totals for :meth:`gradients`."""
        slope = self.line[2]
        through = gradient.contiguous().numpy() * np.where(largest * self.scale + self.shift > 0, type(slope)(1), slope)
        wide = through.astype(np.float64)
        return through, np.stack([wide.sum(axis=(0, 1)), (wide * largest).sum(axis=(0, 1))])

    def gradients(self, total: Reals) -> tuple[Reals, Tensor, Tensor]:
        """Return the factors of :func:`_kernels.sum_gradients`, and the gradients by weight and bias."""
        deviation = np.sqrt(self.variance + self.settings.eps)
        by_weight = (total[1] - self.mean * total[0]) / deviation
        gain = self.weight / deviation
        of_sums = -gain * by_weight / (self.edges * deviation)
        constant = -gain * total[0] / self.edges - of_sums * self.mean
        dtype = self.scale.dtype
        factors = np.stack([gain, of_sums, constant]).astype(dtype)
        return factors, torch.from_numpy(by_weight.astype(dtype)), torch.from_numpy(total[0].astype(dtype))


def _keep_statistics(norm: nn.BatchNorm2d, found: Normalised, edges: int) -> None:
    """Update the running statistics as torch does."""
    if norm.running_mean is None or norm.running_var is None or norm.num_batches_tracked is None:
        return
    with torch.no_grad():
        norm.num_batches_tracked += 1
        momentum = 1 / float(norm.num_batches_tracked) if norm.momentum is None else norm.momentum
        unbiased = found.variance * (edges / max(edges - 1, 1))
        norm.running_mean.lerp_(found.mean.to(norm.running_mean.dtype), momentum)
        norm.running_var.lerp_(unbiased.to(norm.running_var.dtype), momentum)


def _signs(weight: Tensor) -> Reals:
    values: Reals = weight.detach().numpy()
    signs: Reals = np.where(values < 0, values.dtype.type(-1), values.dtype.type(1))
    return signs


def _clouds(there: Tensor, here: Tensor, neighbours: Tensor) -> list[tuple[Any, ...]]:
    arrays = [tensor.detach().contiguous().numpy() for tensor in (there, here, neighbours)]
    return list(zip(*arrays, strict=True))


def _each(kernel: Callable[..., Any], clouds: list[tuple[Any, ...]]) -> list[Any]:
    """Call a kernel for each cloud, on as many threads as torch may use. The results do not depend on their number."""
    threads = min(torch.get_num_threads(), len(clouds))
    if threads < 2:
        return [kernel(*cloud) for cloud in clouds]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda cloud: kernel(*cloud), clouds))
