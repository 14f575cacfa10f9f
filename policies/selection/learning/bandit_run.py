"""Training of a bandit from the logging of attempts to a selector's weights, resumable by bin."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from binpick_env.jobs.workers import Workers
from perception.runtime.provenance import command_line, git_commit, versions
from policies.selection.learning.bandit import BanditConfig, Epoch, fit_bandit
from policies.selection.learning.experience import AttemptLog, Attempts
from policies.selection.weights import save_selector

WEIGHTS = "selector.safetensors"


def train_bandit(
    config: BanditConfig,
    log: AttemptLog,
    bins: int,
    *,
    workers: Workers = 1,
    on_bin: Callable[[int], object] | None = None,
) -> tuple[Path, Epoch]:
    """Log the attempts in ``bins`` bins, fit the network to them and write it to the folder of the log.

    Bins that have been logged already are not picked again.

    Args:
        config: Loss, network and optimiser of the fit.
        log: Folder, cells, behaviour policy and seed; the seed is that of the fit, too.
        bins: Number of bins.
        workers: Number of processes, or a cluster, that log.
        on_bin: Callback with the index of each bin whose attempts are complete.

    Returns:
        Path of the selector, and the quality of the fit after the last pass.

    Raises:
        ValueError: No attempt was made.
        ExperienceError: The folder holds attempts from other bins or under another behaviour policy.
    """
    log.claim()
    for index in log.fill(range(bins), workers):
        if on_bin is not None:
            on_bin(index)
    attempts = log.attempts(range(bins))
    epochs: list[Epoch] = []
    network = fit_bandit(attempts, config, log.seed, epochs.append)
    _write_curves(log.folder / "tensorboard", epochs, attempts)
    record = {"method": "bandit", "bandit": config.record(), **log.plain(), "bins": bins, "attempts": len(attempts)}
    record |= {"gsr_while_logging": float(attempts.delivered.mean()), "last": asdict(epochs[-1])}
    record |= {"command": command_line(), "commit": git_commit(), "versions": versions()}
    path = log.folder / WEIGHTS
    save_selector(path, network, record)
    return path, epochs[-1]


def _write_curves(folder: Path, epochs: list[Epoch], attempts: Attempts) -> None:
    with SummaryWriter(str(folder)) as writer:
        writer.add_scalar("selector/gsr", float(attempts.delivered.mean()), 0)
        for each in epochs:
            for name in ("loss", "held_out", "base", "auc", "within"):
                writer.add_scalar(f"bandit/{name}", getattr(each, name), each.epoch)
