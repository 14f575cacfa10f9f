"""One training of the bandit from logging to weights, resumable by bin."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, git_commit, versions
from policies.selection.learning.bandit import BanditConfig, Epoch, fit_bandit
from policies.selection.learning.experience import Attempts, Behaviour, Cells, bin_file, gather
from policies.selection.weights import save_selector

WEIGHTS, CONFIG = "selector.safetensors", "experience.json"


class ExperienceError(ValueError):
    """The folder holds attempts in other bins."""


def train_bandit(
    config: BanditConfig,
    cells: Cells,
    behaviour: Behaviour,
    out: Path,
    bins: int,
    *,
    seed: int,
    workers: int = 1,
    on_bin: Callable[[int], object] | None = None,
) -> tuple[Path, Epoch]:
    """Log the attempts in ``bins`` bins, fit the network to them and keep it.

    Args:
        config: Of the fit.
        cells: What is picked.
        behaviour: Who chooses while attempts are logged.
        out: Folder of attempts, weights and ``tensorboard``.
        bins: How many; those that lie there already are not picked again.
        seed: Of piles, exploration and fit.
        workers: Processes that log.
        on_bin: Called with the index of each bin that is there.

    Returns:
        Path of the selector, and how well the last pass did.

    Raises:
        ValueError: No attempt was made.
        ExperienceError: The folder holds attempts in other bins, or with another behaviour.
    """
    mine = {"cells": cells.plain(), "behaviour": asdict(behaviour), "seed": seed}
    note = out / CONFIG
    if note.exists() and json.loads(note.read_text()) != json.loads(json_text(mine)):
        raise ExperienceError(f"{out} holds attempts in other bins; choose another folder with --out")
    write_atomically(note, json_text(mine))
    for index in gather(cells, behaviour, out, range(bins), seed, workers):
        if on_bin is not None:
            on_bin(index)
    attempts = Attempts.load([bin_file(out, index) for index in range(bins)])
    epochs: list[Epoch] = []
    network = fit_bandit(attempts, config, seed, epochs.append)
    _log(out / "tensorboard", epochs, attempts)
    rate = float(attempts.delivered.mean())
    record = {"method": "bandit", "bandit": asdict(config), **mine, "bins": bins, "attempts": len(attempts)}
    record |= {"gsr_while_logging": rate, "last": asdict(epochs[-1])}
    record |= {"command": command_line(), "commit": git_commit(), "versions": versions()}
    save_selector(out / WEIGHTS, network, record)
    return out / WEIGHTS, epochs[-1]


def _log(folder: Path, epochs: list[Epoch], attempts: Attempts) -> None:
    with SummaryWriter(str(folder)) as writer:
        writer.add_scalar("selector/gsr", float(attempts.delivered.mean()), 0)
        for each in epochs:
            for name in ("loss", "held_out", "base", "auc", "within"):
                writer.add_scalar(f"bandit/{name}", getattr(each, name), each.epoch)
