"""Table 2 of the paper, trained and judged anew: what each idea adds, under one small budget and on the same scenes."""

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
from binpick_env.parts import load_part
from binpick_env.scenes.synthesis import SceneConfig, generate_scenes, scene_settings
from perception.metrics.average_precision import ap_summary
from perception.metrics.matching import SceneMatches
from perception.runtime.files import json_text, write_atomically
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.scene import SCENES_NOTE, BoundaryScene
from perception.segmentation.scoring import score_scene
from perception.segmentation.training.dataset import BatchMaker, PackedScene, find_scenes, load_packed
from perception.segmentation.training.loop import Length, StepRecord, Trainer
from perception.segmentation.training.losses import PairLossConfig
from perception.segmentation.training.presets import PRESETS, TrainingConfig
from perception.segmentation.training.run import WEIGHTS, RunConfig, resume, train
from perception.segmentation.weights import load_record

TRAINING_SEED, VALIDATION_SEED = 0, 1  # of the scenes that are made here
THRESHOLDS = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0)  # embedding distances to choose from; the margins are 5 and 10
RADII = (0.0005, 0.001, 0.0015, 0.002, 0.003, 0.004, 0.006)  # to choose from [m]; two pixels are 0.4 mm apart
Report = Callable[[str], object]
Network = Literal["sgpn", "dgcnn", "focal", "ours"]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of the table.

    Attributes:
        key: Name of its folder.
        name: For people.
        network: Whose weights it uses; None if nothing is learned.
        merging: Whether points are grouped by SGPN's GroupMerging.
        mask: Whether the distance mask is on.
        paper: Its AP50 and AP75 in the paper.
    """

    key: str
    name: str
    network: Network | None
    merging: bool = False
    mask: bool = False
    paper: tuple[float, float] | None = None

    def method(self, weights: Path | None) -> MethodConfig:
        """Return how the row segments, its threshold or radius still to be chosen."""
        if weights is None:
            return MethodConfig(kind="euclidean")
        grouping: Grouping = "merging" if self.merging else "ours"
        # Neighbourhoods are as dense as in training.
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
    """Return how each network is trained; all share the budget's optimizer, rate, batch, points and average."""
    double = PairLossConfig(kind="double_hinge", anchors=256)
    focal = PairLossConfig(kind="focal_double_hinge", anchors=256)
    mine = PRESETS["ours"]
    return {
        "sgpn": replace(budget, network=SgpnConfig(trunk="pointnet"), pairs=double),
        "dgcnn": replace(budget, network=SgpnConfig(trunk="dgcnn"), pairs=double),
        "focal": replace(budget, network=SgpnConfig(trunk="dgcnn"), pairs=focal),
        "ours": replace(
            budget, network=mine.network, pairs=mine.pairs, alpha=mine.alpha, offset_weight=mine.offset_weight
        ),
    }


@dataclass(frozen=True, kw_only=True)
class AblationConfig:
    """What the table depends on.

    Attributes:
        scenes: That all rows are judged on.
        count: How many.
        training_seeds: Trainings of each network, with seeds 0, 1, ...
        steps: Of each training.
        training: Folder of scenes to train on; ``training_scenes`` are made of seed `TRAINING_SEED` without.
        validation: Folder of scenes to choose thresholds on; ``validation_scenes`` are made without.
        training_scenes: How many are made.
        validation_scenes: How many are made.
        trainings: How each network is trained, its seed aside.
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
            if (made if folder is None else _seed_of(folder, self.scenes.part)) == self.scenes.seed:
                raise ValueError(
                    f"the {name} scenes are those of seed {self.scenes.seed}, which are judged; choose another seed"
                )
        seeds = [
            made if folder is None else _seed_of(folder, self.scenes.part)
            for folder, made in ((self.training, TRAINING_SEED), (self.validation, VALIDATION_SEED))
        ]
        if seeds[0] is not None and seeds[0] == seeds[1]:
            raise ValueError(f"training and validation scenes are both of seed {seeds[0]}; choose another folder")

    def settings(self) -> dict[str, Any]:
        """Return what may not change between runs into one folder; more scenes or trainings may be asked for."""
        folders = {"training": self.training, "validation": self.validation}
        given = {name: None if path is None else str(path) for name, path in folders.items()}
        sizes = {name: getattr(self, name) for name in ("steps", "training_scenes", "validation_scenes")}
        return {**scene_settings(self.scenes), **given, **sizes, **{k: asdict(v) for k, v in self.trainings.items()}}


def _seed_of(folder: Path, part: str) -> int | None:
    """Return the seed of a folder of generated scenes of ``part``, if it says so."""
    try:
        note = json.loads((folder / SCENES_NOTE).read_text())
        return int(note["seed"]) if Path(note["part"]).stem == Path(part).stem else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def run_ablation(config: AblationConfig, out: Path, workers: int = 1, report: Report | None = None) -> AblationTable:
    """Train, choose thresholds, judge and tabulate; what lies in ``out`` already is not done again.

    Args:
        config: What the table depends on.
        out: Folder of scenes, weights, choices and records.
        workers: Processes for scenes and evaluations; a training has this process's cores, or a GPU if there is one.
        report: Called with a line whenever something else is being done.

    Raises:
        ValueError: The folder is another ablation's, or there is no such part.
        FileNotFoundError: A folder that was given holds no scenes.
        TrainingError: A training diverged.
        WorkerError: A process was killed.
        KeyboardInterrupt: A training's state is saved first.
    """
    load_part(config.scenes.part, unit=config.scenes.unit)  # what is not there must not claim the folder
    for given in filter(None, (config.training, config.validation)):
        find_scenes([given])
    ensure_same_config(out / "ablation.json", config.settings(), "an ablation")
    work = _Work(
        config=config,
        out=out,
        workers=workers,
        report=report or (lambda _: None),
        training=_scenes(config, "training", out, workers),
        validation=_scenes(config, "validation", out, workers),
    )
    rows = [work.judged(row) for row in ROWS]
    return tabulate(rows, config.settings(), np.random.default_rng(config.scenes.seed))


def _scenes(config: AblationConfig, use: Literal["training", "validation"], out: Path, workers: int) -> list[Path]:
    """Return the scene files for one use: those of the folder that was given, or made ones."""
    given: Path | None = getattr(config, use)
    if given is not None:
        return find_scenes([given])
    count = getattr(config, f"{use}_scenes")
    scenes = replace(config.scenes, seed=TRAINING_SEED if use == "training" else VALIDATION_SEED)
    for _ in generate_scenes(scenes, count, out / use, workers):
        pass
    return find_scenes([out / use])[:count]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Work:
    """One ablation under way: what is read once, and the steps that every row takes."""

    config: AblationConfig
    out: Path
    workers: int
    report: Report
    training: Sequence[Path]
    validation: Sequence[Path]
    memory: list[PackedScene] = field(default_factory=list)  # the training scenes, once one is trained on

    def judged(self, row: Row) -> RowScores:
        """Return what all trainings of a row reach."""
        scores = RowScores(key=row.key, name=row.name, paper=row.paper)
        for seed in range(self.config.training_seeds if row.network is not None else 1):
            weights = None if row.network is None else self.trained(row.network, seed)
            who, folder = f"{row.name}, training {seed}", self.out / "rows" / f"{row.key}-{seed}"
            self.report(f"{who}: choosing")
            method, tried = self.chosen(row.method(weights), folder / "choice.json")
            evaluation = EvaluationConfig(scenes=self.config.scenes, method=method)
            done = evaluate_scenes(evaluation, self.config.count, folder, self.workers, pictures=False)
            for k, _ in enumerate(done):
                self.report(f"{who}: scene {k + 1} of {self.config.count}")
            minutes = None if weights is None else float(load_record(weights)["minutes"])
            scores = scores.with_training(load_scores(folder, self.config.count), method.distance, tried, minutes)
        return scores

    def trained(self, network: Network, seed: int) -> Path:
        """Return the weights of a training, which is done, or gone on with, if they are not there."""
        folder = self.out / "weights" / f"{network}-{seed}"
        if (folder / WEIGHTS).exists():
            return folder / WEIGHTS
        if not self.memory:
            self.memory.extend(load_packed(self.training))
        training = replace(self.config.trainings[network], seed=seed)
        device = "cuda" if torch.cuda.is_available() else "cpu"
        length = Length(steps=self.config.steps)
        trainer = Trainer(training, BatchMaker.of(training, self.memory), length, device)
        run = RunConfig(out=folder, parts=(Path(self.config.scenes.part).stem,), evaluate_every=np.inf)
        resume(trainer, run)

        def on_step(record: StepRecord) -> None:
            self.report(f"training {network} {seed}: step {record.step} of {self.config.steps}")

        train(trainer, [], run, on_step)
        return folder / WEIGHTS

    def chosen(self, method: MethodConfig, note: Path) -> tuple[MethodConfig, dict[str, float]]:
        """Return the method with the setting of the best AP on validation scenes, and the AP of each that was tried."""
        digest = method.digest()
        if note.exists():
            with suppress(ValueError, KeyError, TypeError):  # a damaged note is written anew
                kept = json.loads(note.read_text())
                if kept["weights"] == digest:
                    return method.with_distance(kept["chosen"]), kept["tried"]
        settings = RADII if method.kind == "euclidean" else THRESHOLDS
        judge = partial(_judge_at, method, settings, self.validation)
        each = list(map_indices(judge, range(len(self.validation)), self.workers))
        aps = [ap_summary([scene[k] for scene in each]).ap for k in range(len(settings))]
        best = settings[int(np.argmax(np.nan_to_num(aps)))]
        tried = {f"{setting:g}": ap for setting, ap in zip(settings, aps, strict=True)}
        write_atomically(note, json_text({"weights": digest, "chosen": best, "tried": tried}))
        return method.with_distance(best), tried


def _judge_at(method: MethodConfig, settings: Sequence[float], paths: Sequence[Path], index: int) -> list[SceneMatches]:
    """Return the verdicts on a validation scene at each setting."""
    scene = BoundaryScene.load(paths[index])
    found = segmenter(method).segment_at(settings, scene.boundary, scene.surface, scene.d_max)
    return [score_scene(scene, instances) for instances in found]
