"""Log the attempts in a few bins, and fit which grasps deliver. A real training takes a hundred bins or more."""

import tempfile
from pathlib import Path

from policies.selection.learning.bandit import BanditConfig, Epoch
from policies.selection.learning.bandit_run import train_bandit
from policies.selection.learning.experience import AttemptLog, Behaviour, Cells


def main(folder: Path, bins: int = 2, num_parts: int = 4) -> tuple[Path, Epoch]:
    """Return the weights' file and the quality of the last pass over the attempts."""
    cells = Cells(part="tee", min_parts=num_parts, max_parts=num_parts, pose_noise="learned", fast=True)
    log = AttemptLog(folder=folder, cells=cells, behaviour=Behaviour(epsilon=0.5), seed=0)
    selector, fit = train_bandit(BanditConfig(held_out=0.0), log, bins=bins)
    print(f"{selector.name}, fitted to {bins} bins: {fit}")  # "too few attempts to judge" after so few
    print("compare it with: binpick evaluate-selector --selectors weighted", selector)
    return selector, fit


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        main(Path(made))
