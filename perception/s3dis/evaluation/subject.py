"""The subject of an evaluation: a trained network, or the ground truth, and the rooms to evaluate it on."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perception.s3dis.choices import Identity, Population
from perception.s3dis.data.categories import AREAS, TEST_AREA
from perception.s3dis.data.room import find_rooms
from perception.s3dis.evaluation.identities import predict_ground_truth, predict_merged_ground_truth_blocks
from perception.s3dis.predictor import RoomPredictor
from perception.s3dis.scoring import Predict
from perception.segmentation.weights import load_record

IDENTITIES: dict[Identity, Predict] = {
    "ground_truth": predict_ground_truth,
    "merged_ground_truth_blocks": predict_merged_ground_truth_blocks,
}


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A prediction to evaluate, and the rooms."""

    rooms: Path  # folder of rooms made by prepare
    weights: Path | None = None  # weights of a trained network to evaluate
    predictions: Identity | None = None  # upper bound to evaluate instead of a network
    areas: tuple[int, ...] | None = None  # areas to evaluate on; 5 for weights, all for the truth unless given
    threshold: float | None = None  # threshold of the network's grouping; that of its training unless given
    population: Population = "room"  # points that count: each point once, or the points of all blocks as in SGPN's code
    seed: int = 0  # seed of the division of blocks into samples

    def __post_init__(self) -> None:
        if (self.weights is None) == (self.predictions is None):
            raise ValueError(f"give either weights or predictions, got {self.weights} and {self.predictions}")

    @property
    def name(self) -> str:
        """Return the name of the row in a table."""
        if self.weights is None:
            return str(self.predictions)
        return str(load_record(self.weights).get("row", self.weights.stem))

    def paths(self) -> list[Path]:
        """Return the files of the rooms.

        Raises:
            FileNotFoundError: There are no rooms.
        """
        areas = self.areas or (AREAS if self.weights is None else (TEST_AREA,))
        return find_rooms(self.rooms, areas)

    def predict(self, device: str = "cpu") -> Predict:
        """Return the function that predicts a room.

        Raises:
            WeightsError: The weights are missing, damaged, or not of a training on rooms.
        """
        if self.predictions is not None:
            return IDENTITIES[self.predictions]
        assert self.weights is not None
        return RoomPredictor.from_file(self.weights, device, self.threshold)

    def note(self) -> dict[str, Any]:
        """Return a description of the subject, to store with its scores."""
        given = {"predictions": self.predictions, "population": self.population, "seed": self.seed}
        if self.weights is None:
            return given
        record = load_record(self.weights)
        return {**given, "weights": str(self.weights), "threshold": self.threshold, "training": record}
