"""``BinPickSelect-v0``: Gymnasium's and SB3's contracts, repeatability, and masks through wrappers."""

import inspect
import pickle
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.utils.env_checker import check_env

import binpick_env  # noqa: F401  registers the id
from binpick_env.env import BinPickEnv
from binpick_env.options import CellOptions
from policies.grasping.clearance import RankSettings
from policies.picking.settings import PickerSettings
from policies.selection.candidate_generator import ROWS
from policies.selection.env import MAX_EPISODE_STEPS, GraspSelectionEnv
from policies.selection.features import FEATURES
from tests.policies.selection_cell import SMALL, assert_same, step

# SB3 tells that a 2-D array is unusual; a set of grasps is meant.
TWO_DIMENSIONAL = "Your observation grasps has an unconventional shape"


@pytest.fixture(scope="module")
def shared_env() -> Iterator[GraspSelectionEnv]:
    env = GraspSelectionEnv(**SMALL)
    yield env
    env.close()


# --- contracts -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_gymnasiums_checker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the shared cell is made: the checker makes a second cell for each way to render."""
    # It makes every declared mode; the viewer is not to be had without a display.
    monkeypatch.setitem(GraspSelectionEnv.metadata, "render_modes", ["rgb_array", "depth_array"])
    env = gym.make("BinPickSelect-v0", **SMALL).unwrapped
    check_env(env)
    env.close()


@pytest.mark.slow
@pytest.mark.filterwarnings(f"ignore:{TWO_DIMENSIONAL}:UserWarning")
def test_sb3s_checker(shared_env: GraspSelectionEnv) -> None:
    from stable_baselines3.common.env_checker import check_env as check_sb3

    check_sb3(shared_env)


def test_any_mesh_has_the_learned_perceivers_errors(tmp_path: Path) -> None:
    """A part without a noise model of its own takes that for every part."""
    path = tmp_path / "wedge.stl"
    trimesh.creation.cone(radius=14, height=40, sections=16).export(path)
    env = gym.make("BinPickSelect-v0", part=str(path), pose_noise="learned", **SMALL | {"num_parts": 3})
    observation, _ = env.reset(seed=2)
    cell = env.unwrapped.cell
    assert observation["mask"].any()
    own = [candidate for candidate in cell.candidates if candidate.part >= 0]
    assert own
    errors = [
        np.linalg.norm((c.T_world_part - cell.labelled_capture.T_world_parts[c.part])[:3, 3]) for c in own if c.score
    ]
    assert 0 < min(errors) < 0.1 * cell.part.model.d_max
    env.close()


def test_the_registration_truncates() -> None:
    spec = gym.spec("BinPickSelect-v0")
    assert spec.max_episode_steps == MAX_EPISODE_STEPS == 200
    env = gym.make("BinPickSelect-v0", max_episode_steps=1, max_failures=None, **SMALL)
    env.reset(seed=1)
    *_, terminated, truncated, _ = env.step(ROWS - 1)
    assert (terminated, truncated) == (False, True)
    env.close()


def test_the_default_is_to_see_with_the_learned_pipeline() -> None:
    assert inspect.signature(GraspSelectionEnv).parameters["perception"].default == "learned"


def test_the_docstring_describes_every_argument_and_feature() -> None:
    text = inspect.cleandoc(GraspSelectionEnv.__doc__ or "")  # Python 3.13 takes the indentation off itself
    arguments = text[text.index("## Arguments") :]
    assert all(f"`{name}`" in arguments for name in inspect.signature(GraspSelectionEnv).parameters)
    table = text[text.index("| index |") : text.index("## Reward")]
    listed = [name for cells in re.findall(r"^\| \d[\d to,]* \| (.*?) \|", table, re.M) for name in cells.split(", ")]
    assert [name.strip("`") for name in listed] == list(FEATURES)


def test_every_option_of_the_cell_is_taken() -> None:
    """Every keyword of ``BinPick-v0`` but the shape of its observation, with the same default."""
    cell, own = (inspect.signature(kind).parameters for kind in (BinPickEnv, GraspSelectionEnv))
    missing = [name for name in cell if name not in own]
    assert missing == ["obs_mode"]
    assert all(own[name].default == cell[name].default for name in cell if name in own)


@pytest.mark.slow
def test_options_of_the_cell_arrive() -> None:
    options: dict[str, Any] = {"density": 1000.0, "symmetry": "none", "bin": (0.3, 0.2, 0.1), "jaw": 0.07}
    options |= {"camera_distance": 0.8, "width": 640, "height": 480, "hand_eye_mm": 5.0, "friction": 0.3}
    options |= {"max_acceleration": 4.0, "max_jerk": 50.0}
    env = GraspSelectionEnv(part="tee", **SMALL | {"camera": None}, **options)
    expected = CellOptions(part="tee", **options)
    for made in (env, pickle.loads(pickle.dumps(env))):
        assert made.cell.config == expected.cell()
        assert made.cell.part is expected.load_part()
    env.close()
    with pytest.raises(ValueError, match="unit must be one of"):
        GraspSelectionEnv(**SMALL, unit="foot")  # type: ignore[arg-type]


@pytest.mark.slow
def test_two_copies_stay_equal(shared_env: GraspSelectionEnv) -> None:
    """Bit for bit through attempts, although one of them has another episode behind it."""
    shared_env.reset(seed=5)
    step(shared_env, 0)
    envs = shared_env, GraspSelectionEnv(**SMALL)
    for seed, rows_chosen in ((3, (1, ROWS - 1, 0)), (None, (2,))):
        starts = [env.reset(seed=seed) for env in envs]
        for one, other in zip(*starts, strict=True):
            assert_same(one, other)
        rows, over = iter(rows_chosen), False
        while not over and (row := next(rows, None)) is not None:
            steps = [step(env, row) for env in envs]
            assert_same(steps[0][0], steps[1][0])
            assert steps[0][1:4] == steps[1][1:4]
            assert_same(steps[0][4], steps[1][4])
            over = steps[0][2]
    envs[1].close()


def test_a_pickled_copy_behaves_the_same() -> None:
    picker = PickerSettings(rank=RankSettings(per_candidate=2))
    env = GraspSelectionEnv("bracket", sensor="harsh", picker=picker, per_part=1, max_failures=None, **SMALL)
    copy = pickle.loads(pickle.dumps(env))
    assert (copy.max_failures, copy.per_part, copy.picker.settings) == (None, 1, picker.attempts_only())
    assert copy.observation_space == env.observation_space
    for one, other in zip(env.reset(seed=6), copy.reset(seed=6), strict=True):
        assert_same(one, other)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"max_failures": 0}, "max_failures must be at least 1, or None for never, got 0"),
        ({"per_part": 0}, "per_part must be from 1 to 8, the number that the ranking keeps, got 0"),
        ({"per_part": 9}, "per_part must be from 1 to 8, the number that the ranking keeps, got 9"),
    ],
)
def test_nonsense_is_refused(arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        GraspSelectionEnv(**SMALL | arguments)


# --- masks through wrappers ------------------------------------------------------------------------------------------


def test_masks_come_through_wrappers() -> None:
    from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
    from stable_baselines3.common.monitor import Monitor

    env = Monitor(gym.make("BinPickSelect-v0", **SMALL))
    assert is_masking_supported(env)
    observation, info = env.reset(seed=2)
    masks = get_action_masks(env)
    assert masks.shape == (ROWS,)
    assert masks.dtype == np.bool_
    assert masks.any()
    np.testing.assert_array_equal(masks, observation["mask"])
    np.testing.assert_array_equal(masks, info["action_mask"])
    env.close()


def copies(count: int, **options: Any) -> Any:
    """Return a vector of copies, the first of which has seed 4."""
    from stable_baselines3.common.env_util import make_vec_env

    return make_vec_env("binpick_env:BinPickSelect-v0", n_envs=count, seed=4, env_kwargs=SMALL, **options)


@pytest.mark.slow
def test_a_copy_in_a_process_is_this_environment(shared_env: GraspSelectionEnv) -> None:
    """One process alone: each takes seconds to start."""
    from sb3_contrib.common.maskable.utils import get_action_masks
    from stable_baselines3.common.vec_env import SubprocVecEnv

    vector = copies(1, vec_env_cls=SubprocVecEnv, vec_env_kwargs={"start_method": "forkserver"})
    observation = vector.reset()
    np.testing.assert_array_equal(get_action_masks(vector), observation["mask"])
    expected, _ = shared_env.reset(seed=4)
    np.testing.assert_array_equal(observation["grasps"][0], expected["grasps"])
    observation, *_ = vector.step(np.zeros(1, np.int64))
    np.testing.assert_array_equal(observation["grasps"][0], step(shared_env, 0)[0]["grasps"])
    vector.close()


@pytest.mark.slow
def test_maskable_ppo_learns_on_copies(shared_env: GraspSelectionEnv) -> None:
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.utils import get_action_masks

    vector = copies(2)
    observation = vector.reset()
    np.testing.assert_array_equal(get_action_masks(vector), observation["mask"])
    expected, _ = shared_env.reset(seed=4)
    np.testing.assert_array_equal(observation["grasps"][0], expected["grasps"])
    assert np.any(observation["grasps"][1] != expected["grasps"])
    model = MaskablePPO("MultiInputPolicy", vector, n_steps=2, batch_size=4, n_epochs=1, seed=0)
    model.learn(4)
    observation = vector.reset()
    masks = get_action_masks(vector)
    action, _ = model.predict(observation, action_masks=masks)
    assert masks[np.arange(2), action].all()
    vector.close()
