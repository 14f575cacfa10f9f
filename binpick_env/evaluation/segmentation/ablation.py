"""Ablation of table 2 of the paper: networks trained with one small budget and evaluated on the same scenes."""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from binpick_env.evaluation.segmentation.ablation_summary import AblationTable, RowScores, tabulate
from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, evaluate_scenes
from binpick_env.evaluation.segmentation.method import Grouping, MethodConfig, segmenter
from binpick_env.evaluation.segmentation.summary import load_scores
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers
from binpick_env.parts.label import part_label
from binpick_env.scenes.synthesis import OLDER_SETTINGS, SceneConfig, generate_scenes, is_of_part, scene_settings
from perception.metrics.average_precision import ap_summary
from perception.metrics.matching import SceneMatches
from perception.runtime.files import json_text, write_atomically
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.scene import SCENES_NOTE, BoundaryScene
from perception.segmentation.scoring import score_scene
from perception.segmentation.training.dataset import BatchMaker, find_scenes, load_packed
from perception.segmentation.training.loop import Length, StepRecord, Trainer
from perception.segmentation.training.losses import PairLossConfig
from perception.segmentation.training.packed import PackedScene
from perception.segmentation.training.presets import PRESETS, TrainingConfig
from perception.segmentation.training.run import WEIGHTS, RunConfig, resume, train
from perception.segmentation.weights import load_record

TRAINING_SEED, VALIDATION_SEED = 0, 1  # seeds of the scenes that are generated unless folders are given
THRESHOLDS = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0)  # candidate embedding distances; the margins are 5 and 10
RADII = (0.0005, 0.001, 0.0015, 0.002, 0.003, 0.004, 0.006)  # candidate radii [m]; two pixels are 0.4 mm apart
Report = Callable[[str], object]
Network = Literal["sgpn", "dgcnn", "focal", "ours"]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of the table.

    Attributes:
        key: Name of the folder of the row's records.
        name: Name of the row in the printed table.
        network: Network whose weights the row uses; None if nothing is learned.
        merging: Whether points are grouped by SGPN's GroupMerging.
        mask: Whether points farther apart than d_max are prevented from sharing a group.
        paper: AP50 and AP75 of this row in the paper; None without such a row.
    """

    key: str
    name: str
    network: Network | None
    merging: bool = False
    mask: bool = False
    paper: tuple[float, float] | None = None

    def method(self, weights: Path | None) -> MethodConfig:
        """Return the segmentation method of the row, with the default grouping distance."""
        if weights is None:
            return MethodConfig(kind="euclidean")
        grouping: Grouping = "merging" if self.merging else "ours"
        # The subset has the size of a training sample, so that neighbourhoods are as dense as in training.
        return MethodConfig(weights=weights, grouping=grouping, mask=self.mask, subset=BUDGET.points)


ROWS = (
    Row(key="euclidean", name="Euclidean components", network=None),
    Row(key="sgpn", name="SGPN: PointNet, eq. 1", network="sgpn", merging=True, paper=(0.127, 0.0)),
    Row(key="dgcnn", name="DGCNN, eq. 1", network="dgcnn", merging=True, paper=(0.276, 0.037)),
    Row(key="focal", name="+ focal double hinge", network="focal", merging=True, paper=(0.461, 0.230)),
    Row(key="mask", name="+ distance mask", network="focal", merging=True, mask=True, paper=(0.505, 0.254)),
    Row(key="grouped", name="+ all points grouped", network="focal", mask=True),
    Row(key="ours", name="ours", network="ours", mask=True),
)
BUDGET = TrainingConfig(batch=4, points=2048)


def trainings(budget: TrainingConfig = BUDGET) -> dict[Network, TrainingConfig]:
    """Return the training of each network; all share the budget's optimizer, learning rate, batch, points and EMA."""
    double = PairLossConfig(kind="double_hinge", anchors=256)
    focal = PairLossConfig(kind="focal_double_hinge", anchors=256)
    ours = PRESETS["ours"]
    return {
        "sgpn": replace(budget, network=SgpnConfig(trunk="pointnet"), pairs=double),
        "dgcnn": replace(budget, network=SgpnConfig(trunk="dgcnn"), pairs=double),
        "focal": replace(budget, network=SgpnConfig(trunk="dgcnn"), pairs=focal),
        "ours": replace(
            budget, network=ours.network, pairs=ours.pairs, alpha=ours.alpha, offset_weight=ours.offset_weight
        ),
    }


@dataclass(frozen=True, kw_only=True)
class AblationConfig:
    """Configuration that the table depends on.

    Attributes:
        scenes: Configuration of the scenes that every row is evaluated on.
        count: Number of scenes that every row is evaluated on.
        training_seeds: Number of trainings of each network, with seeds 0, 1, ...
        steps: Number of steps of each training.
        training: Folder of scenes to train on; without one they are generated with seed `TRAINING_SEED`.
        validation: Folder of scenes to choose thresholds on; without one they are generated with `VALIDATION_SEED`.
        training_scenes: Number of scenes to generate for training.
        validation_scenes: Number of scenes to generate for validation.
        trainings: Training of each network; its seed is replaced.
    """

    scenes: SceneConfig = field(default_factory=lambda: SceneConfig(part="part_a", seed=7))
    count: int = 100
    training_seeds: int = 3
    steps: int = 1500
    training: Path | None = None
    validation: Path | None = None
    training_scenes: int = 300
    validation_scenes: int = 8
    trainings: dict[Network, TrainingConfig] = field(default_factory=trainings)

    def __post_init__(self) -> None:
        for name in ("count", "training_seeds", "steps", "training_scenes", "validation_scenes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name, made in (("training", TRAINING_SEED), ("validation", VALIDATION_SEED)):
            folder = getattr(self, name)
            if (made if folder is None else _seed_of(folder, self.scenes)) == self.scenes.seed:
                raise ValueError(
                    f"the {name} scenes are those of seed {self.scenes.seed}, which are evaluated; choose another seed"
                )
        seeds = [
            made if folder is None else _seed_of(folder, self.scenes)
            for folder, made in ((self.training, TRAINING_SEED), (self.validation, VALIDATION_SEED))
        ]
        if seeds[0] is not None and seeds[0] == seeds[1]:
            raise ValueError(f"training and validation scenes are both of seed {seeds[0]}; choose another folder")

    def settings(self) -> dict[str, Any]:
        """Return the settings that must not change between runs into one folder; counts of scenes and trainings may."""
        folders = {"training": self.training, "validation": self.validation}
        paths = {name: None if path is None else str(path) for name, path in folders.items()}
        sizes = {name: getattr(self, name) for name in ("steps", "training_scenes", "validation_scenes")}
        return {**scene_settings(self.scenes), **paths, **sizes, **{k: asdict(v) for k, v in self.trainings.items()}}


def _seed_of(folder: Path, scenes: SceneConfig) -> int | None:
    """Return the seed of a folder of scenes of the part of ``scenes``; None if it is unknown or of another part."""
    try:
        stored = json.loads((folder / SCENES_NOTE).read_text(encoding="utf-8"))
        return int(stored["seed"]) if is_of_part(stored, scenes) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def run_ablation(
    config: AblationConfig, out: Path, workers: Workers = 1, report: Report | None = None
) -> AblationTable:
    """Train, choose thresholds, evaluate and tabulate; results that ``out`` holds already are reused.

    Args:
        config: Configuration of the table.
        out: Folder of scenes, weights, chosen thresholds and records.
        workers: Number of worker processes, or a cluster, for scenes and evaluations. Trainings run in this process, on
            all its cores or on a GPU.
        report: Function that is called with a line of text on the progress.

    Raises:
        ValueError: The folder holds another ablation, or there is no such part.
        FileNotFoundError: The folder of training or validation scenes holds no scenes.
        TrainingError: A training diverged.
        WorkerError: A worker process was killed.
        KeyboardInterrupt: The run was interrupted; the state of the current training is saved.
    """
    config.scenes.options().load_part()  # before the folder gets a configuration
    for given in filter(None, (config.training, config.validation)):
        find_scenes([given])
    ensure_same_config(out / "ablation.json", config.settings(), "an ablation", assumed=OLDER_SETTINGS)
    run = _AblationRun(
        config=config,
        out=out,
        workers=workers,
        report=report or (lambda _: None),
        training=_scenes(config, "training", out, workers),
        validation=_scenes(config, "validation", out, workers),
    )
    rows = [run.evaluate_row(row) for row in ROWS]
    return tabulate(rows, config.settings(), np.random.default_rng(config.scenes.seed))


def _scenes(config: AblationConfig, use: Literal["training", "validation"], out: Path, workers: Workers) -> list[Path]:
    """Return the scene files for training or validation: those of the given folder, or generated ones."""
    given: Path | None = getattr(config, use)
    if given is not None:
        return find_scenes([given])
    count = getattr(config, f"{use}_scenes")
    scenes = replace(config.scenes, seed=TRAINING_SEED if use == "training" else VALIDATION_SEED)
    for _ in generate_scenes(scenes, count, out / use, workers):
        pass
    return find_scenes([out / use])[:count]


@dataclass(frozen=True, eq=False, kw_only=True)
class _AblationRun:
    """One run of an ablation: scenes that are read once, and the steps for each row."""

    config: AblationConfig
    out: Path
    workers: Workers
    report: Report
    training: Sequence[Path]
    validation: Sequence[Path]
    packed: list[PackedScene] = field(default_factory=list)  # training scenes, read before the first training

    def evaluate_row(self, row: Row) -> RowScores:
        """Return the scores of all trainings of a row."""
        scores = RowScores(key=row.key, name=row.name, paper=row.paper)
        for seed in range(self.config.training_seeds if row.network is not None else 1):
            weights = None if row.network is None else self.train_network(row.network, seed)
            name, folder = f"{row.name}, training {seed}", self.out / "rows" / f"{row.key}-{seed}"
            self.report(f"{name}: choosing")
            method, tried = self.choose_distance(row.method(weights), folder / "choice.json")
            evaluation = EvaluationConfig(scenes=self.config.scenes, method=method)
            done = evaluate_scenes(evaluation, self.config.count, folder, self.workers, pictures=False)
            for k, _ in enumerate(done):
                self.report(f"{name}: scene {k + 1} of {self.config.count}")
            minutes = None if weights is None else float(load_record(weights)["minutes"])
            scores = scores.with_training(
                load_scores(folder, self.config.count), method.grouping_distance, tried, minutes
            )
        return scores

    def train_network(self, network: Network, seed: int) -> Path:
        """Return the weights of a training, which is run, or resumed, unless they exist."""
        folder = self.out / "weights" / f"{network}-{seed}"
        if (folder / WEIGHTS).exists():
            return folder / WEIGHTS
        if not self.packed:
            self.packed.extend(load_packed(self.training))
        training = replace(self.config.trainings[network], seed=seed)
        device = "cuda" if torch.cuda.is_available() else "cpu"
        length = Length(steps=self.config.steps)
        trainer = Trainer(training, BatchMaker.of(training, self.packed), length, device)
        run = RunConfig(out=folder, parts=(part_label(self.config.scenes.part),), evaluate_every=np.inf)
        resume(trainer, run)

        def on_step(record: StepRecord) -> None:
            self.report(f"training {network} {seed}: step {record.step} of {self.config.steps}")

        train(trainer, [], run, on_step)
        return folder / WEIGHTS

    def choose_distance(self, method: MethodConfig, path: Path) -> tuple[MethodConfig, dict[str, float]]:
        """Choose the grouping distance by AP on validation scenes; return the method, and the AP of each distance.

        The choice is written to ``path``, and read from there in later runs with the same weights.
        """
        digest = method.digest()
        if path.exists():
            with suppress(ValueError, KeyError, TypeError):  # a damaged file is replaced
                stored = json.loads(path.read_text(encoding="utf-8"))
                if stored["weights"] == digest:
                    return method.with_grouping_distance(stored["chosen"]), stored["tried"]
        distances = RADII if method.kind == "euclidean" else THRESHOLDS
        match = partial(_match_scene, method, distances, self.validation)
        scenes = list(map_indices(match, range(len(self.validation)), self.workers))
        aps = [ap_summary([scene[k] for scene in scenes]).ap for k in range(len(distances))]
        best = distances[int(np.argmax(np.nan_to_num(aps)))]
        tried = {f"{distance:g}": ap for distance, ap in zip(distances, aps, strict=True)}
        write_atomically(path, json_text({"weights": digest, "chosen": best, "tried": tried}))
        return method.with_grouping_distance(best), tried


def _match_scene(
    method: MethodConfig, distances: Sequence[float], paths: Sequence[Path], index: int
) -> list[SceneMatches]:
    """Segment a validation scene with each grouping distance, and match the instances to its parts."""
    scene = BoundaryScene.load(paths[index])
    found = segmenter(method).segment_at(distances, scene.boundary, scene.surface, scene.d_max, scene.shape)
    return [score_scene(scene, instances) for instances in found]
