"""Pooling over sets of rows on the CPU: gather present rows, pool them, and their gradients.

Torch would process every slot in every operation, although a robot observes two or three of the 24
obstacles of a typical scenario.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from rendezvous_env.compilation import kernel


def pooled(network: nn.Module, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and maximum feature over the present rows of (N, slots, columns), (N, width) each.

    Absent rows are zero. Both are zero for an empty set; features must be non-negative.
    """
    if rows.device.type != "cpu":
        return pooled_anywhere(network, rows)
    there = rows.new_empty(rows.shape[0] * rows.shape[1], rows.shape[2])
    counts = np.empty(len(rows), dtype=np.int64)
    found = gather(rows.detach().numpy(), there.numpy(), counts)
    mean, largest = _Pool.apply(network(there[:found]), counts)
    return mean, largest


def pooled_anywhere(network: nn.Module, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Pure torch version of ``pooled``, on any device."""
    present = rows.any(dim=-1)
    owner = present.nonzero()[:, 0]
    features = network(rows[present])
    empty = features.new_zeros(len(rows), features.shape[-1])
    count = present.sum(dim=-1, keepdim=True).clamp(min=1)
    largest = empty.scatter_reduce(0, owner[:, None].expand_as(features), features, "amax")
    return empty.index_add(0, owner, features) / count, largest


class _Pool(torch.autograd.Function):
    """Mean and maximum over the contiguous rows of each robot."""

    @staticmethod
    def forward(context: Any, features: Tensor, counts: Any) -> tuple[Tensor, Tensor]:
        mean = features.new_empty(len(counts), features.shape[1])
        largest = torch.empty_like(mean)
        pool(features.detach().numpy(), counts, mean.numpy(), largest.numpy())
        context.save_for_backward(features, largest)
        context.counts = counts
        return mean, largest

    @staticmethod
    def backward(context: Any, *given: Tensor) -> tuple[Tensor, None]:
        features, largest = (tensor.detach() for tensor in context.saved_tensors)
        gradient, each = torch.empty_like(features), np.empty(features.shape[1], dtype=np.float32)
        wanted = (tensor.contiguous().numpy() for tensor in given)
        spread(features.numpy(), largest.numpy(), context.counts, *wanted, each, gradient.numpy())
        return gradient, None


@kernel
def gather(rows, there, counts):
    """Write the non-zero rows contiguously, with the count of each robot; returns their number."""
    found = 0
    for i in range(rows.shape[0]):
        before = found
        for m in range(rows.shape[1]):
            if np.any(rows[i, m]):
                for k in range(rows.shape[2]):
                    there[found, k] = rows[i, m, k]
                found += 1
        counts[i] = found - before
    return found


@kernel
def pool(features, counts, mean, largest):
    """Mean and maximum of each robot's features, (N, width) each; zero for an empty set."""
    mean[:] = 0.0
    largest[:] = 0.0
    first = 0
    for i in range(len(counts)):
        for row in range(first, first + counts[i]):
            for j in range(features.shape[1]):
                mean[i, j] += features[row, j]
                largest[i, j] = max(largest[i, j], features[row, j])
        first += counts[i]
        share = np.float32(1.0) / np.float32(max(counts[i], 1))
        for j in range(features.shape[1]):
            mean[i, j] *= share


@kernel
def spread(features, largest, counts, of_mean, of_largest, each, gradient):
    """Feature gradients from those of means and maxima, split evenly between ties.

    ``each`` (width,) is overwritten.
    """
    width = features.shape[1]
    first = 0
    for i in range(len(counts)):
        stop = first + counts[i]
        share = np.float32(1.0) / np.float32(max(counts[i], 1))
        each[:] = 0.0
        for row in range(first, stop):
            for j in range(width):
                each[j] += np.float32(features[row, j] == largest[i, j])
        for j in range(width):
            each[j] = of_largest[i, j] / max(each[j], np.float32(1.0))
        for row in range(first, stop):
            for j in range(width):
                more = each[j] if features[row, j] == largest[i, j] else np.float32(0.0)
                gradient[row, j] = of_mean[i, j] * share + more
        first = stop
