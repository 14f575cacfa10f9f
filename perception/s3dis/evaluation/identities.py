"""The truth as a prediction: whole, and cut into blocks and merged again. Both say what an evaluation is worth."""

import numpy as np

from perception.instance import Instance
from perception.s3dis.data.blocks import BlockConfig, cover_room
from perception.s3dis.data.room import Room
from perception.s3dis.merging import BlockMerger, MergeConfig, SampleGroups


def ground_truth(room: Room) -> list[Instance]:
    """Return the true objects, in the order of their ids, all with score 1."""
    order = np.argsort(room.instance, kind="stable")
    categories = room.category_of_instance()
    starts = np.searchsorted(room.instance[order], np.arange(len(categories) + 1))
    return [
        Instance(point_idx=order[starts[k] : starts[k + 1]], score=1.0, label=int(categories[k]))
        for k in range(len(categories))
        if starts[k + 1] > starts[k]
    ]


def merged_ground_truth_blocks(
    room: Room,
    rng: np.random.Generator,
    blocks: BlockConfig | None = None,
    merging: MergeConfig | None = None,
) -> list[Instance]:
    """Return the objects that merging makes of true groups: what is lost here, no network can win.

    Note: 0.5 million points a second.
    """
    merger = BlockMerger(room.xyz, merging)
    for sample in cover_room(room.xyz, blocks or BlockConfig(), rng):
        idx = sample.point_idx[: sample.distinct]
        groups = np.unique(room.instance[idx], return_inverse=True)[1]
        merger.add(
            SampleGroups(
                point_idx=idx,
                groups=groups.astype(np.int64),
                categories=room.semantic[idx].astype(np.int64),
                confidences=np.ones(len(idx)),
            )
        )
    return merger.instances()


def predict_ground_truth(room: Room, rng: np.random.Generator) -> list[Instance]:  # noqa: ARG001
    """Return `ground_truth`; a prediction as an evaluation wants it."""
    return ground_truth(room)


def predict_merged_ground_truth_blocks(room: Room, rng: np.random.Generator) -> list[Instance]:
    """Return `merged_ground_truth_blocks` with the standard blocks and constants."""
    return merged_ground_truth_blocks(room, rng)
