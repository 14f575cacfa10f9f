"""``binpick train-selector``: a grasp selector, trained by MaskablePPO or as a contextual bandit on logged attempts."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from binpick_env.config import Perception
from binpick_env.parts.label import part_label
from policies.commands.cell_arguments import CellArguments
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from policies.selection.learning.experience import Cells


@dataclass(frozen=True, kw_only=True)
class Common(CellArguments):
    """What both methods are told."""

    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    perception: Perception = "oracle"  # where poses come from; learned (from pixels) for the last stretch of a training
    pose_noise: Literal["learned"] | None = None  # learned: true poses get errors such as the learned perception makes
    fast: bool = False  # leave out the physics of an arm that touches nothing
    max_failures: int = 2  # number of consecutive failed attempts that end a bin
    seed: int = 0  # seed of piles, weights and order
    out: Path | None = None  # folder of the training; runs/selector-METHOD-PART-SEED unless given

    def cells(self) -> "Cells":
        """Return the bins that experience is gathered in."""
        from policies.selection.learning.experience import Cells

        return Cells(**{name: getattr(self, name) for name in Cells.__dataclass_fields__})

    def folder(self, method: str) -> Path:
        """Return where the training is kept."""
        return self.out or Path("runs") / f"selector-{method}-{part_label(self.part)}-{self.seed}"


@dataclass(frozen=True, kw_only=True)
class Ppo(WorkerArguments, Common):
    """Train by MaskablePPO. The same command resumes where it was stopped; more --picks train further.

    For a last stretch with the real perception, use the same folder, more --picks and --perception learned.
    """

    workers: int = 1  # number of environments, each in a process on one core, on a cluster as well
    # run the environments on a Ray cluster, on --workers of its cores: the address host:port of its head node, auto for
    # the cluster that this machine belongs to, or local to start one of --workers processes here
    cluster: str | None = None
    picks: int = 20_000  # number of picks in all
    rollout: int = 128  # number of picks of each environment between two updates
    initial: Path | None = None  # selector to start from, such as the bandit's, a .safetensors file
    hidden: int = 64  # number of units in each layer of the network


@dataclass(frozen=True, kw_only=True)
class Bandit(WorkerArguments, Common):
    """Log attempts, then fit which grasps are delivered. Bins that are already logged are kept."""

    workers: int = 1  # number of processes, each on one core
    bins: int = 200  # number of bins whose attempts are logged
    behaviour: str = "weighted"  # selector that picks while attempts are logged: a heuristic, or a trained one
    epsilon: float = 0.3  # share of the choices that are random, in [0, 1]
    tries: int = 1  # number of attempts from each state; all but the chosen one are random, and are undone
    hidden: int = 64  # number of units in each layer of the network; 0 is logistic regression
    context: bool = True  # whether a grasp's score depends on the other candidates
    features: tuple[str, ...] = ()  # names of the observation's columns that the network uses; all unless given
    # delivery, or choice: compare attempts from one state, which needs --tries
    loss: Literal["delivery", "choice"] = "delivery"
    epochs: int = 60  # number of passes over the attempts
    rate: float = 1e-3  # learning rate of Adam; logistic regression takes ten times as much
    held_out: float = 0.2  # share of the bins that the fit is evaluated on; 0 uses all bins to fit


Arguments = Ppo | Bandit


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and train; return the exit code."""
    return run(parse(Arguments, "train-selector", arguments))


def run(args: Arguments) -> int:
    """Train; return the exit code."""
    from binpick_env.jobs.workers import WorkerError

    work = (lambda: _train_ppo(args)) if isinstance(args, Ppo) else (lambda: _train_bandit(args))
    return exit_code(work, (ValueError, OSError, ModuleNotFoundError, WorkerError))


def _train_ppo(args: Ppo) -> str:
    from binpick_env.jobs.workers import Cluster
    from policies.commands.progress import ProgressBar
    from policies.selection.learning.ppo import PpoConfig, train_ppo
    from policies.selection.network import SelectorNetConfig

    network = SelectorNetConfig(hidden=args.hidden)
    size = {"n_envs": args.workers, "n_steps": args.rollout, "batch_size": min(64, args.rollout)}
    places = args.places()
    cluster = places if isinstance(places, Cluster) else None
    config = PpoConfig(network=network, **size, seed=args.seed, cluster=cluster)
    with ProgressBar(total=args.picks, unit="pick", smoothing=0) as bar:

        def on_progress(picks: int, rates: dict[str, float]) -> None:
            bar.update(picks - bar.n)
            bar.set_postfix({name: f"{value:.3f}" for name, value in rates.items() if value == value})  # not NaN

        path = train_ppo(
            config, args.cells(), args.folder("ppo"), args.picks,
            initial=args.initial, on_progress=on_progress,
        )  # fmt: skip
    return f"kept in {path}"


def _train_bandit(args: Bandit) -> str:
    from policies.commands.progress import ProgressBar
    from policies.selection.learning.bandit import BanditConfig
    from policies.selection.learning.bandit_run import train_bandit
    from policies.selection.learning.experience import AttemptLog, Behaviour
    from policies.selection.network import SelectorNetConfig

    features = args.features or SelectorNetConfig().features
    network = SelectorNetConfig(features=features, hidden=args.hidden, context=args.context)
    fit = {name: getattr(args, name) for name in ("loss", "epochs", "held_out")}
    config = BanditConfig(network=network, learning_rate=args.rate, **fit)
    behaviour = Behaviour(selector=args.behaviour, epsilon=args.epsilon, tries=args.tries)
    with ProgressBar(total=args.bins, unit="bin", smoothing=0) as bar:
        log = AttemptLog(folder=args.folder("bandit"), cells=args.cells(), behaviour=behaviour, seed=args.seed)
        path, last = train_bandit(config, log, args.bins, workers=args.places(), on_bin=lambda _: bar.update())
    judged = f"on held-out bins: {last}" if args.held_out else f"on all bins, fitted: cross-entropy {last.loss:.3f}"
    return f"{judged}\nkept in {path}"
