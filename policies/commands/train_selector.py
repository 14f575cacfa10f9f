"""``binpick train-selector``: a grasp selector, trained by MaskablePPO or as a contextual bandit on logged attempts."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from binpick_env.config import Perception
from policies.commands.cell_arguments import CellArguments
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    from policies.selection.learning.experience import Cells


@dataclass(frozen=True, kw_only=True)
class Common(CellArguments):
    """What both methods are told."""

    min_parts: int = 20  # smallest fill of a bin
    max_parts: int = 30  # largest fill
    perception: Perception = "oracle"  # learned for the last stretch of a training
    pose_noise: Literal["learned"] | None = None  # the oracle's: errors such as the learned perceiver's, or none
    fast: bool = False  # leave out the physics of an arm that touches nothing
    max_failures: int = 2  # in a row, that end a bin
    workers: int = 1  # processes; each computes on one core
    seed: int = 0  # of piles, weights and order
    out: Path | None = None  # folder of the training; runs/selector-METHOD-PART-SEED unless given

    def cells(self) -> "Cells":
        """Return the bins that experience is gathered in."""
        from policies.selection.learning.experience import Cells

        return Cells(**{name: getattr(self, name) for name in Cells.__dataclass_fields__})

    def folder(self, method: str) -> Path:
        """Return where the training is kept."""
        return self.out or Path("runs") / f"selector-{method}-{Path(self.part).stem}-{self.seed}"


@dataclass(frozen=True, kw_only=True)
class Ppo(Common):
    """Train by MaskablePPO. The same command again goes on where it was stopped, more picks go further.

    For a last stretch with the real perception: the same folder, more picks, --perception learned.
    """

    picks: int = 20_000  # in all
    rollout: int = 128  # picks of each process between updates
    initial: Path | None = None  # selector to start from, the bandit's for one
    hidden: int = 64  # units of the network's layers


@dataclass(frozen=True, kw_only=True)
class Bandit(Common):
    """Log attempts, then fit which grasps are delivered. Bins that are logged already stay."""

    bins: int = 200  # whose attempts are logged
    behaviour: str = "weighted"  # who chooses meanwhile: a heuristic, or a trained selector
    epsilon: float = 0.3  # share of the choices that are made at random instead
    tries: int = 1  # attempts from each state; all but the one that is chosen are drawn at random, and undone
    hidden: int = 64  # units of the network's layers; 0 is logistic regression
    context: bool = True  # whether a grasp's score depends on the others on offer
    features: tuple[str, ...] = ()  # columns of the observation that it uses, by name; none for all
    loss: Literal["delivery", "choice"] = "delivery"  # choice compares what was tried from one state, with --tries
    epochs: int = 60  # passes over the attempts
    rate: float = 1e-3  # Adam's; logistic regression takes ten times that
    held_out: float = 0.2  # share of the bins that the fit is judged on instead; 0 for the selector that is to be used


Arguments = Ppo | Bandit


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and train; return the exit code."""
    return run(parse(Arguments, "train-selector", arguments))


def run(args: Arguments) -> int:
    """Train; return the exit code."""
    work = (lambda: _train_ppo(args)) if isinstance(args, Ppo) else (lambda: _train_bandit(args))
    return exit_code(work, (ValueError, OSError, ModuleNotFoundError))


def _train_ppo(args: Ppo) -> str:
    from tqdm import tqdm

    from policies.selection.learning.ppo import PpoConfig, train_ppo
    from policies.selection.network import SelectorNetConfig

    network = SelectorNetConfig(hidden=args.hidden)
    size = {"n_envs": args.workers, "n_steps": args.rollout, "batch_size": min(64, args.rollout)}
    config = PpoConfig(network=network, **size, seed=args.seed)
    with tqdm(total=args.picks, unit="pick", smoothing=0) as bar:

        def on_progress(picks: int, rates: dict[str, float]) -> None:
            bar.update(picks - bar.n)
            bar.set_postfix({name: f"{value:.3f}" for name, value in rates.items()})

        path = train_ppo(
            config, args.cells(), args.folder("ppo"), args.picks,
            initial=args.initial, on_progress=on_progress,
        )  # fmt: skip
    return f"kept in {path}"


def _train_bandit(args: Bandit) -> str:
    from tqdm import tqdm

    from policies.selection.learning.bandit import BanditConfig
    from policies.selection.learning.bandit_run import train_bandit
    from policies.selection.learning.experience import AttemptLog, Behaviour
    from policies.selection.network import SelectorNetConfig

    features = args.features or SelectorNetConfig().features
    network = SelectorNetConfig(features=features, hidden=args.hidden, context=args.context)
    fit = {name: getattr(args, name) for name in ("loss", "epochs", "held_out")}
    config = BanditConfig(network=network, learning_rate=args.rate, **fit)
    behaviour = Behaviour(selector=args.behaviour, epsilon=args.epsilon, tries=args.tries)
    with tqdm(total=args.bins, unit="bin", smoothing=0) as bar:
        log = AttemptLog(folder=args.folder("bandit"), cells=args.cells(), behaviour=behaviour, seed=args.seed)
        path, last = train_bandit(config, log, args.bins, workers=args.workers, on_bin=lambda _: bar.update())
    judged = f"on held-out bins: {last}" if args.held_out else f"on all bins, fitted: cross-entropy {last.loss:.3f}"
    return f"{judged}\nkept in {path}"
