"""DGCNN's trunk edge by edge: every distance, every ``[x_i, x_j - x_i]`` and the tiled cloud vector spelled out."""

import torch


def nearest(cloud, k):
    """Return for each point of (N, C) the indices of its k nearest, itself first."""
    graph, cloud = [], cloud.detach()
    for i in range(len(cloud)):
        squares = [float(((cloud[j] - cloud[i]) ** 2).sum()) for j in range(len(cloud))]
        squares[i] = -1.0
        graph.append(sorted(range(len(cloud)), key=squares.__getitem__)[:k])
    return graph


def shared(layer, rows, slope):
    """Apply one shared layer of the trunk to (M, C) rows."""
    sums = torch.stack([layer.linear.weight @ row for row in rows])
    norm = layer.norm
    if norm.training:
        mean, variance = sums.mean(0), ((sums - sums.mean(0)) ** 2).mean(0)
    else:
        mean, variance = norm.running_mean, norm.running_var
    normed = (sums - mean) / torch.sqrt(variance + norm.eps) * norm.weight + norm.bias
    return torch.where(normed > 0, normed, slope * normed)


def dgcnn(trunk, points, k, graph_channels=(0, 1, 2), reuse_graph=False, slope=0.2):
    """Return the (B, N, F) features that a DGCNNTrunk with these weights must give."""
    count = points.shape[1]
    graphs = [nearest(cloud[:, list(graph_channels)], k) for cloud in points]
    x, outputs = points, []
    for depth, edge_conv in enumerate(trunk.edges):
        if depth > 0 and not reuse_graph:
            graphs = [nearest(cloud, k) for cloud in x]
        rows = torch.stack(
            [
                torch.cat([cloud[i], cloud[j] - cloud[i]])
                for cloud, graph in zip(x, graphs, strict=True)
                for i in range(count)
                for j in graph[i]
            ]
        )
        for layer in [edge_conv.first, *edge_conv.rest]:
            rows = shared(layer, rows, slope)
        x = rows.reshape(len(points), count, -1, rows.shape[-1]).max(2)[0]
        outputs.append(x)
    rows = torch.cat(outputs, dim=-1).flatten(0, 1)
    clouds = shared(trunk.cloud, rows, slope).reshape(len(points), count, -1).max(1)[0]
    tiled = torch.stack([cloud for cloud in clouds for _ in range(count)])
    rows = torch.cat([rows, tiled], dim=-1)
    rows = shared(trunk.head, shared(trunk.join, rows, slope), slope)
    return rows.reshape(len(points), count, -1)
