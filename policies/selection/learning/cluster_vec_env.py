"""A vector of environments on the nodes of a Ray cluster, for SB3's algorithms."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from binpick_env.jobs.cluster_job import Outcome
from binpick_env.jobs.ray_cluster import ATTEMPTS, GIVEN_UP
from binpick_env.jobs.ray_objects import ClusterObjects
from binpick_env.jobs.workers import Cluster, WorkerError
from policies.selection.learning.episodes import Episode, ReplayableEnv

Maker = Callable[[], gym.Env[Any, Any]]
Observations = dict[str, NDArray[Any]]
Calls = Mapping[int, tuple[str, tuple[Any, ...]]]  # methods of a `ReplayableEnv` and their arguments, by environment
Indices = int | Iterable[int] | None


class Objects(Protocol):
    """Objects of :class:`ReplayableEnv`, as :class:`binpick_env.jobs.ray_objects.ClusterObjects` keeps them."""

    def call(self, index: int, method: str, *arguments: Any) -> None:
        """Let an object, which is made if it is not there, call a method."""

    def finished(self) -> Iterator[tuple[int, Outcome | None]]:
        """Yield the outcomes of calls that are done, None if the object was lost."""

    def close(self) -> None:
        """End the objects."""


class ClusterVecEnv(VecEnv):
    """Environments in worker processes on a cluster, each on one core.

    They give the same observations, rewards and infos as those of SB3's own vectors, times apart. Where a worker is
    lost, the episode of its environment is played again on another one up to the present state, and goes on.
    Attributes that were set, and whatever other calls than ``reset`` and ``step`` changed, would be lost.

    Args:
        objects: A :class:`ReplayableEnv` for each environment; observations are dictionaries of arrays.
        count: Number of environments.
    """

    def __init__(self, objects: Objects, count: int) -> None:
        self._objects = objects
        self._episodes: list[Episode | None] = [None] * count
        self._observed: list[Observations] = [{}] * count
        self._steps: Calls = {}
        (observation_space, action_space), *_ = self._ask("spaces", range(count))
        super().__init__(count, observation_space, action_space)

    def reset(self) -> Observations:
        """Begin an episode in every environment."""
        if None in self._episodes and None in self._seeds:
            self.seed()
        arguments = list(zip(self._seeds, self._options, strict=True))
        answers = self._call({k: ("reset", each) for k, each in enumerate(arguments)})
        for k, (seed, options) in enumerate(arguments):
            self._observed[k], self.reset_infos[k] = answers[k]
            former = self._episodes[k]
            if seed is not None:
                self._episodes[k] = Episode(series=seed, options=options)
            elif former is not None:
                self._episodes[k] = Episode(series=former.series, number=former.number + 1, options=options)
        self._reset_seeds()
        self._reset_options()
        return _stacked(self._observed)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Send an action to every environment."""
        self._steps = {k: ("step", (actions[k : k + 1],)) for k in range(self.num_envs)}
        self._send(self._steps)

    def step_wait(self) -> tuple[Observations, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Return observations, rewards, whether episodes are over, and infos."""
        answers = self._collect(self._steps)
        self._observed, rewards, dones, infos, reset_infos = map(list, zip(*answers, strict=True))
        self.reset_infos = reset_infos
        for k, (episode, done) in enumerate(zip(self._episodes, dones, strict=True)):
            assert episode is not None
            self._episodes[k] = episode.after(self._steps[k][1][0], done[0])
        return _stacked(self._observed), np.concatenate(rewards), np.concatenate(dones), infos

    def close(self) -> None:
        """End the workers."""
        self._objects.close()

    def env_method(self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any) -> Any:
        """Return the result of a method of each environment; see `VecEnv`."""
        return self._ask("env_method", self._get_indices(indices), method_name, method_args, method_kwargs)

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of each environment; see `VecEnv`."""
        return self._ask("get_attr", self._get_indices(indices), attr_name)

    def has_attr(self, attr_name: str) -> bool:
        """Tell whether all environments have an attribute, without sending its value."""
        return all(self._ask("has_attr", range(self.num_envs), attr_name))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Refuse to set an attribute, which would be forgotten with a lost worker."""
        raise NotImplementedError("attributes of environments on a cluster cannot be set")

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Tell for each environment whether it has a wrapper; see `VecEnv`."""
        return self._ask("is_wrapped", self._get_indices(indices), wrapper_class)

    # --- calls -------------------------------------------------------------------------------------------------------

    def _ask(self, method: str, indices: Iterable[int], *arguments: Any) -> list[Any]:
        return self._call(dict.fromkeys(indices, (method, arguments)))

    def _call(self, calls: Calls) -> list[Any]:
        self._send(calls)
        return self._collect(calls)

    def _send(self, calls: Calls) -> None:
        for k, (method, arguments) in calls.items():
            self._objects.call(k, method, *arguments)

    def _collect(self, calls: Calls) -> list[Any]:
        """Return the answers to calls in their order; an environment that is lost in the meantime is made anew."""
        answers: dict[int, Any] = {}
        lost = Counter[int]()
        while len(answers) < len(calls):
            for k, outcome in self._objects.finished():
                if outcome is None:
                    lost[k] += 1
                    if lost[k] == ATTEMPTS:
                        raise WorkerError(GIVEN_UP.format(what=f"a step of environment {k}", attempts=ATTEMPTS))
                    self._objects.call(k, "resume", self._episodes[k], *calls[k])
                elif lost[k]:
                    replayed, answers[k] = outcome.result
                    self._check_replayed(k, replayed)
                else:
                    answers[k] = outcome.result
        return [answers[k] for k in calls]

    def _check_replayed(self, k: int, replayed: Observations | None) -> None:
        known = self._observed[k]
        if replayed is not None and not all(np.array_equal(replayed[name], known[name]) for name in known):
            raise WorkerError(
                f"environment {k} cannot go on, since the worker that took the place of a lost one computes other bits "
                "than that: use nodes with processors of one kind; the same command resumes from the last checkpoint"
            )


def environments_on_cluster(makers: Sequence[Maker], cluster: Cluster) -> ClusterVecEnv:
    """Make environments on a cluster.

    Args:
        makers: Each makes one of them, with a :class:`policies.selection.learning.episodes.SeededEpisodes` around it.
            They must be picklable; files that they name travel with them.
        cluster: Where they are.

    Raises:
        WorkerError: Ray is not installed, the cluster cannot be joined or has too few cores, or a node runs another
            build of the project. Steps raise it, too, where the cluster is lost, or workers are lost again and again.
    """
    objects = ClusterObjects(partial(_replayable, makers), len(makers), cluster)
    try:
        return ClusterVecEnv(objects, len(makers))
    except BaseException:
        objects.close()
        raise


def _replayable(makers: Sequence[Maker], index: int) -> ReplayableEnv:
    return ReplayableEnv(makers[index])


def _stacked(observations: Sequence[Observations]) -> Observations:
    return {name: np.concatenate([each[name] for each in observations]) for name in observations[0]}
