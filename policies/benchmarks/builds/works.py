"""The works that builds are compared by. Each adapts to the build that it runs in, whatever its modules are called.

A work is a function of the job. It prepares what every input needs, and returns ``ready``: ``ready(k)`` prepares input
k and returns the call that is timed. That call returns a function that describes its result, which is not timed.
This file imports nothing of any build before a work asks for it.
"""

import importlib
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

Job = dict[str, Any]
Describe = Callable[[], dict[str, Any]]
Ready = Callable[[int], Callable[[], Describe]]
ATTEMPTS = 4  # number of attempts of the selection environment that are timed at once
CLOUDS, POINTS = 4, 1024  # clouds of a training step, and points of each


class MissingInterfaceError(Exception):
    """The build has nothing that the work needs."""


def frame(job: Job) -> Ready:
    """Poses of a frame by the learned pipeline; the bin's pose is given."""
    Frame, Workspace = find("Frame", "perception.frame"), find("Workspace", "perception.frame")
    with np.load(job["inputs"]) as given:
        workspace = Workspace(T_world_bin=given["T_world_bin"], inner_size=given["inner_size"])
    limit = use_threads(job)
    with limit():
        part = find("load_part", "binpick_env.parts")(job["part"], **unit_of(job)).model
        for_part = find("Pipeline", "perception.pipeline").for_part
        pipeline = for_part(part, workspace, **accepted(for_part, measure_bin=False))

    def ready(k: int) -> Callable[[], Describe]:
        with np.load(job["inputs"]) as given:
            images = {name: given[f"{name}_{k}"] for name in ("grey", "depth")}
            seen_by = Frame(**images, K=given["K"], T_world_cam=given["T_world_cam"][k])

        def call() -> Describe:
            with limit():
                seen = pipeline.perceive(seen_by)
            poses = np.array([[*pose.T_cam_part.ravel(), pose.score] for pose in seen.poses])
            return lambda: {"values": poses.tobytes(), "fact": len(poses), "stages": dict(seen.ms)}

        return call

    return ready


def camera(job: Job) -> Ready:
    """A frame of the simulated camera."""
    env, put = _pile(job)

    def ready(k: int) -> Callable[[], Describe]:
        put(k)
        rng = np.random.default_rng(k)

        def call() -> Describe:
            seen = env.camera.capture(env.simulation.data, rng, job["sensor"]).frame
            values = seen.depth.tobytes() + seen.grey.tobytes()
            return lambda: {"values": values, "fact": int(np.count_nonzero(seen.depth))}

        return call

    return ready


def attempt(job: Job) -> Ready:
    """One attempt of the scripted picker in the full simulation, with the true poses."""
    env, put = _pile(job)
    picker = find("ScriptedPicker", "policies.picking.scripted", "policies.scripted")(env)

    def ready(k: int) -> Callable[[], Describe]:
        env.reset(seed=job["seed"] + k)
        put(k)
        env.simulation.advance(1.0)
        env.look()
        picker.reset()
        before = env.simulation.time

        def call() -> Describe:
            result = picker.pick()
            values = np.array(env.simulation.part_poses()).tobytes()
            outcome = getattr(result.outcome, "value", result.outcome) or "no attempt"
            simulated = 1000 * (env.simulation.time - before)
            stages = {"planning and perception": 1000 * result.t_compute, "simulated time": simulated}
            return lambda: {"values": values, "fact": str(outcome), "stages": stages}

        return call

    return ready


def select(job: Job) -> Ready:
    """Attempts of the weighted heuristic in the fast selection environment; each build drops its own piles."""
    kind = find("GraspSelectionEnv", "policies.selection.env", "policies.selection_env")
    selector = find("WeightedSelector", "policies.selection.selectors", "policies.selectors")()
    given = {"num_parts": job["count"], "sensor": job["sensor"], "threads": job["threads"], "fast": True}
    env = kind(part=job["part"], **unit_of(job), perception="oracle", **given)

    def ready(k: int) -> Callable[[], Describe]:
        observation, _ = env.reset(seed=job["seed"] + k)
        rng = np.random.default_rng(k)

        def call() -> Describe:
            now, made, over = observation, 0, False
            for _ in range(ATTEMPTS):
                row = selector.select(now, rng) if now["mask"].any() else 0
                now, _, terminated, truncated, _ = env.step(np.int64(row))
                made += env.result is not None
                over = terminated or truncated
                if over:
                    break
            return lambda: {"values": np.array(now["mask"]).tobytes(), "fact": made}

        return call

    return ready


def scenes(job: Job) -> Ready:
    """A labelled scene, from the drop to its boundary points."""
    make_scene, config = _scene_config(job)

    def ready(k: int) -> Callable[[], Describe]:
        def call() -> Describe:
            scene = make_scene(config, k).scene
            points = scene.boundary.points_cam
            return lambda: {"values": points.tobytes(), "fact": len(points)}

        return call

    return ready


def training(job: Job) -> Ready:
    """One step of the training of the shared network, on two scenes that each build makes."""
    from dataclasses import replace

    folder = "perception.segmentation"
    packed = find("PackedScene", f"{folder}.training.packed", f"{folder}.dataset")
    maker = find("BatchMaker", f"{folder}.training.dataset", f"{folder}.dataset")
    trainer = find("Trainer", f"{folder}.training.loop", f"{folder}.training")
    length = find("Length", f"{folder}.training.loop", f"{folder}.training")
    presets = find("PRESETS", f"{folder}.training.presets", f"{folder}.presets")
    make_scene, config = _scene_config(job)
    ours = replace(presets["ours"], batch=CLOUDS, points=POINTS)
    batches = maker.of(ours, [packed.pack(make_scene(config, k).scene) for k in range(2)])
    limit = use_threads(job)
    with limit():
        steps = trainer(ours, batches, length(steps=10_000)).run()

    def ready(_: int) -> Callable[[], Describe]:
        def call() -> Describe:
            with limit():
                total = next(steps).losses["total"]
            return lambda: {"values": np.float64(total).tobytes(), "fact": round(total, 4)}

        return call

    return ready


def _scene_config(job: Job) -> tuple[Any, Any]:
    """Return the function that makes a scene, and its configuration."""
    modules = ("binpick_env.scenes.synthesis", "binpick_env.synthesis")
    make_scene, kind = find("make_scene", *modules), find("SceneConfig", *modules)
    number = (job["count"], job["count"])
    return make_scene, kind(part=job["part"], **unit_of(job), seed=job["seed"], sensor=job["sensor"], num_parts=number)


def _pile(job: Job) -> tuple[Any, Callable[[int], None]]:
    """Return an environment, and the function that puts its parts as pile k has them."""
    given = {"num_parts": job["count"], "sensor": job["sensor"], "threads": job["threads"]}
    env = find("BinPickEnv", "binpick_env.env")(part=job["part"], **unit_of(job), perception="oracle", **given)
    env.reset(seed=job["seed"])
    with np.load(job["inputs"]) as stored:
        piles = stored["T_world_part"]

    def put(k: int) -> None:
        for i, T_world_part in enumerate(piles[k]):
            env.simulation.place(i, T_world_part)
        env.simulation.refresh()

    return env, put


def unit_of(job: Job) -> dict[str, Any]:
    """Return the unit of the part's file as an argument; none where it is not given: older builds know no unit."""
    return {"unit": job["unit"]} if job["unit"] else {}


def use_threads(job: Job) -> Callable[[], Any]:
    """Return the context that limits the number of threads of a computation."""
    limit = find("use_threads", "perception.runtime.threads", "perception.threads")
    return lambda: limit(job["threads"])


def accepted(function: Callable[..., Any], **arguments: Any) -> dict[str, Any]:
    """Return those of the arguments that a function has parameters for."""
    known = inspect.signature(function).parameters
    return {name: value for name, value in arguments.items() if name in known}


def find(name: str, *modules: str) -> Any:
    """Return what is called ``name`` in the first of the modules that has it.

    Raises:
        MissingInterfaceError: None of them has it.
    """
    for module in modules:
        try:
            return getattr(importlib.import_module(module), name)
        except AttributeError:
            continue
        except ModuleNotFoundError as error:
            if error.name is None or not (module + ".").startswith(error.name + "."):
                raise  # the module is there, and lacks a package that it needs
    raise MissingInterfaceError(f"it has no {name} in {' or '.join(modules)}")
