"""From per-point outputs to instances: grouping by similarity, GroupMerging, Euclidean components."""
