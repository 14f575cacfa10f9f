"""``BinPick-v0``'s rewards, its ends, its parts, and its pictures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env import env as env_module
from binpick_env.cell.delivery import Delivery
from binpick_env.cell.robot import HOME
from binpick_env.env import BinPickEnv
from tests.binpick_env.small_cell import REST, above_tray, act, assert_same, centred, small_env

# --- rewards and ends


def test_a_delivery_is_rewarded_once(env: BinPickEnv) -> None:
    env.simulation.place(0, above_tray(env.simulation))
    steps = act(env, 3.0)
    rewards = [reward for _, reward, *_ in steps]
    assert sum(rewards) == 1.0
    when = int(np.argmax(rewards))
    info = steps[when][4]
    assert (info["delivered"], info["remaining"], info["total"], info["last_event"]) == (1, 2, 3, "delivered")
    assert steps[when + 1][4]["last_event"] == ""
    assert steps[-1][4]["delivered"] == 1
    assert not any(terminated for *_, terminated, _, _ in steps)
    assert [event.kind for event in env.events] == [Delivery.DELIVERED]
    assert not env.unjudged()


def test_company_in_the_tray_earns_nothing(env: BinPickEnv) -> None:
    for i in range(2):
        env.simulation.place(i, above_tray(env.simulation, x=0.12 * i - 0.06))
    steps = act(env, 3.0)
    assert sum(reward for _, reward, *_ in steps) == 0.0
    assert steps[-1][4]["remaining"] == 1
    assert [event.kind for event in env.events] == [Delivery.DOUBLE] * 2


def test_a_lost_part_is_waited_for(env: BinPickEnv) -> None:
    env.simulation.place(0, centred(env.simulation, (0.8, 0.4, 0.05)))
    act(env, 0.4)
    assert env.unjudged()
    assert sum(reward for _, reward, *_ in act(env, 3.0)) == 0.0
    assert [event.kind for event in env.events] == [Delivery.LEFT_BIN]
    assert not env.unjudged()


@pytest.mark.parametrize(("place", "success"), [("tray", True), ("table", False)])
def test_an_episode_ends_when_nothing_is_left(env: BinPickEnv, place: str, success: bool) -> None:
    env.reset(seed=0, options={"num_parts": 1})
    pose = above_tray(env.simulation) if place == "tray" else centred(env.simulation, (0.8, 0.4, 0.05))
    env.simulation.place(0, pose)
    for _ in range(100):
        *_, terminated, truncated, info = env.step(REST)
        assert info["success"] is info["is_success"] is (terminated and success)
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["remaining"] == env.remaining == 0


def test_info_says_when_the_protective_stop_holds_the_arm(env: BinPickEnv) -> None:
    down = np.append(HOME + np.array([0.0, 0.8, 0.0, 0.0, 0.0, 0.0]), 1.0).astype(np.float32)  # under the tray's floor
    stopped = [info["protective_stop"] for *_, info in act(env, 0.6, down)]
    assert stopped == sorted(stopped)
    assert (stopped[0], stopped[-1]) == (False, True)
    *_, info = env.step(REST)
    assert info["protective_stop"] is False
    env.step(down)
    assert env.reset(seed=0)[1]["protective_stop"] is False


def test_a_new_episode_forgets_the_last(env: BinPickEnv) -> None:
    env.simulation.place(0, above_tray(env.simulation))
    act(env, 2.0)
    assert env.delivered == 1
    _, info = env.reset(seed=1)
    assert (info["delivered"], info["remaining"], info["frame_id"]) == (0, 3, 0)
    assert env.events == []
    assert env.simulation.time == 0.0


# --- parts


@pytest.mark.parametrize(("num_parts", "wanted"), [(2, {2}), ((1, 3), {1, 2, 3}), ([2, 2], {2})])
def test_the_number_of_parts_is_drawn_from_its_range(
    num_parts: Any, wanted: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(env_module, "drop_and_settle", lambda *_: None)
    env = small_env(num_parts=num_parts)
    assert {env.reset(seed=seed)[1]["total"] for seed in range(20)} == wanted


def test_a_mesh_file_is_a_part_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "block.stl"
    trimesh.creation.box((0.07, 0.04, 0.03)).export(path)
    env = small_env(part=str(path))
    observation, _ = env.reset(seed=0)
    assert observation["candidate_mask"].any()


# --- pictures


def test_render_modes_return_arrays() -> None:
    env = small_env(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((480, 640, 3), np.uint8)
    assert picture.std() > 10
    env.close()
    env.close()  # does no harm
    env = small_env(render_mode="depth_array")
    env.reset(seed=0)
    depth = env.render()
    assert depth is not None
    assert (depth.shape, depth.dtype) == ((120, 160), np.float32)
    capture = env.capture
    assert capture is not None
    np.testing.assert_array_equal(depth, capture.depth_true)
    env.close()


def test_rendering_changes_nothing() -> None:
    watched, alone = small_env(render_mode="depth_array"), small_env()
    for env in (watched, alone):
        env.reset(seed=0)
    watched.render()
    assert_same(watched.look(), alone.look())


def test_without_a_mode_there_is_no_picture(env: BinPickEnv) -> None:
    assert env.render() is None


def test_human_mode_without_a_display_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = small_env(render_mode="human")
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match="render_mode='human' needs a display, and none is set; 'rgb_array' needs"):
        env.step(REST)


def test_human_mode_refreshes_the_viewer(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[int] = []
    env = small_env(render_mode="human")
    monkeypatch.setattr(env._renderer, "show", lambda: shown.append(1))
    env.reset(seed=0)
    act(env, 0.12)
    assert len(shown) >= 3
