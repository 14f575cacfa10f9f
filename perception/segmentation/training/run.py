"""A complete training, new or resumed: checkpoints, evaluations, a log, the weights."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from perception.metrics.average_precision import ap_summary
from perception.runtime.files import json_text
from perception.runtime.provenance import command_line, git_commit, versions
from perception.segmentation.grouping.similarity import GroupingConfig
from perception.segmentation.predictor import PredictorConfig, SegmentationPredictor
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.scoring import score_scene
from perception.segmentation.training.checkpoint import load_checkpoint, save_checkpoint
from perception.segmentation.training.loop import StepRecord, Trainer
from perception.segmentation.weights import Network, load_network, load_record, record_of_initial, save_network

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.jsonl"
WEIGHTS = "weights.safetensors"


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Outputs of a training, and how often they are written.

    Attributes:
        out: Folder of the checkpoint, the log and the weights.
        parts: Names of the parts that the network is trained on.
        initial: Weights that the training starts from; None for random ones.
        evaluate_every: Time of training between evaluations [min].
        save_every: Time of training between checkpoints [min].
        scene_minutes: Time that was spent on making the scenes before the training [min]; the log names it.
        leader: Whether this process writes files; of several processes that train together, one does.
        sources: Description of the scenes for the record, as :func:`.dataset.scene_sources` returns it, and anything
            else to record.
    """

    out: Path
    parts: tuple[str, ...]
    initial: Path | None = None
    evaluate_every: float = 10.0
    save_every: float = 2.0
    scene_minutes: float = 0.0
    leader: bool = True
    sources: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError("parts must name at least one part")
        for name in ("evaluate_every", "save_every"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.scene_minutes >= 0:
            raise ValueError(f"scene_minutes must not be negative, got {self.scene_minutes}")


Log = dict[str, Any]
Judge = Callable[[Network], dict[str, float]]  # returns the named scores of a network


def resume(trainer: Trainer, config: RunConfig) -> bool:
    """Resume a training from the checkpoint in its folder, or start it from the initial weights if there is none.

    A checkpoint tells which weights the training started from, whatever the initial weights are now.

    Returns:
        Whether there was a checkpoint.

    Raises:
        CheckpointError: The checkpoint is damaged, or belongs to another training.
        WeightsError: The initial weights are missing or damaged.
        TrainingError: The initial weights are those of another network.
    """
    path = config.out / CHECKPOINT
    if config.initial is not None:
        trainer.initial = record_of_initial(load_record(config.initial))
    if not path.exists():
        if config.initial is not None:
            trainer.start_from(load_network(config.initial))
        return False
    load_checkpoint(path, trainer)
    return True


def train(
    trainer: Trainer,
    validation: Sequence[Path] | Judge,
    config: RunConfig,
    on_step: Callable[[StepRecord], None] | None = None,
    on_evaluation: Callable[[Log], None] | None = None,
) -> Log:
    """Train to the end and write the weights.

    A new training begins a new log. Its first line, of step 0, is the evaluation of the initial weights, if there are
    initial weights and something to validate on.

    Args:
        trainer: New or resumed training.
        validation: Scene files that are not trained on, or a function that scores a network. Without files there is no
            validation.
        config: Outputs, and how often they are written.
        on_step: Called after each step with its record.
        on_evaluation: Called with each line of the log.

    Returns:
        The last line of the log; empty for a process that does not lead.

    Raises:
        TrainingError: The training diverged; the last checkpoint remains.
        KeyboardInterrupt: The state is saved first; within a step, the last checkpoint remains.
    """
    git_commit()  # cached now, so that commits made during the training do not change it
    saved = evaluated = trainer.elapsed
    if trainer.step == 0 and config.leader:
        (config.out / LOG).unlink(missing_ok=True)
        if config.initial is not None and validation:
            _log_line(trainer, validation, config, on_evaluation)
    try:
        for record in trainer.run():
            if not record.skipped:
                trainer.unlogged.append(record.losses)
            if on_step is not None:
                on_step(record)
            if trainer.elapsed - evaluated >= 60 * config.evaluate_every and config.leader:
                evaluated = trainer.elapsed
                _log_line(trainer, validation, config, on_evaluation)
                trainer.unlogged = []
            if trainer.elapsed - saved >= 60 * config.save_every and config.leader:
                saved = trainer.elapsed
                save_checkpoint(config.out / CHECKPOINT, trainer)
    except KeyboardInterrupt:
        if config.leader and trainer.whole:
            save_checkpoint(config.out / CHECKPOINT, trainer)
        raise
    if not config.leader:
        return {}
    save_checkpoint(config.out / CHECKPOINT, trainer)
    line = _log_line(trainer, validation, config, on_evaluation)
    save_network(config.out / WEIGHTS, trainer.best_network(), training_record(trainer, config, line))
    return line


def training_record(trainer: Trainer, config: RunConfig, last: Log) -> Log:
    """Return the record of a training that is stored with its weights."""
    return {
        "parts": list(config.parts),
        "training": asdict(trainer.config),
        "steps": trainer.step,
        "minutes": trainer.elapsed / 60,
        "scenes": len(trainer.batches.scenes),
        **({"scene_minutes": config.scene_minutes} if config.scene_minutes else {}),
        **config.sources,
        "epochs": trainer.epoch,
        "initial": trainer.initial,
        "validation": last.get("validation"),
        "git_commit": git_commit(),
        "command": command_line(),
        "versions": versions(),
    }


def read_log(path: Path) -> list[Log]:
    """Return the lines of a log, the last one of each step, in order; lines that were cut off are left out."""
    lines: dict[int, Log] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except ValueError:
            continue
        lines[line["step"]] = line
    return [lines[step] for step in sorted(lines)]


def validate(network: Network, paths: Sequence[Path], distance: str = "l2") -> dict[str, float]:
    """Return ``ap``, ``ap50``, ``ap75`` and ``ms_per_scene`` of a network over scene files, all parts pooled.

    Args:
        network: Network to score.
        paths: Scene files.
        distance: Distance in the embedding that the network was trained with.
    """
    grouping = GroupingConfig(distance="scaled_square" if distance == "scaled_square" else "l2")
    predictor = SegmentationPredictor(network, PredictorConfig(grouping=grouping), next(network.parameters()).device)
    matches, times = [], []
    for path in paths:
        scene = BoundaryScene.load(path)
        started = time.perf_counter()
        instances = predictor.predict(scene.boundary, scene.surface, scene.d_max, scene.shape)
        times.append(time.perf_counter() - started)
        matches.append(score_scene(scene, instances))
    summary = ap_summary(matches)
    return {
        "ap": summary.ap,
        "ap50": summary.ap50,
        "ap75": summary.ap75,
        "ms_per_scene": 1000 * float(np.median(times)),
    }


def _log_line(
    trainer: Trainer,
    validation: Sequence[Path] | Judge,
    config: RunConfig,
    on_evaluation: Callable[[Log], None] | None,
) -> Log:
    losses = trainer.unlogged
    means = {name: float(np.mean([loss[name] for loss in losses])) for name in (losses[0] if losses else ())}
    line: Log = {"step": trainer.step, "minutes": trainer.elapsed / 60, "losses": means}
    if config.scene_minutes:
        line["scene_minutes"] = config.scene_minutes
    if callable(validation):
        line["validation"] = validation(trainer.best_network())
    elif validation:
        line["validation"] = validate(trainer.best_network(), validation, trainer.config.pairs.distance)
    config.out.mkdir(parents=True, exist_ok=True)
    with (config.out / LOG).open("a", encoding="utf-8") as file:
        file.write(json.dumps(json.loads(json_text(line))) + "\n")
    if on_evaluation is not None:
        on_evaluation(line)
    return line
