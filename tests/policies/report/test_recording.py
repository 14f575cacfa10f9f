import dataclasses
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from binpick_env.config import CONTROL_PERIOD, CameraConfig
from binpick_env.env import BinPickEnv
from perception.geometry import matrix_from_quat
from policies.evaluation.bin_evaluation import BinError, evaluate_bin
from policies.evaluation.cell import CellCache, scripted_cell
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.records import BinRecord
from policies.evaluation.watched_env import WatchedEnv
from policies.grasping.outcomes import PickResult
from policies.report.recording import Recording, check_recording
from tests.policies.fake_cell import abstain
from tests.policies.report.rrd_file import RrdFile
from tests.shared_models import share_shaded_meshes

pytestmark = pytest.mark.slow

CONFIG = EvaluationConfig(
    part="part_c", seed=31, perception="oracle", num_parts=(2, 2), camera=CameraConfig(width=320, height=240)
)
LINKS = {"shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link"}


@pytest.fixture(autouse=True, scope="module")
def _meshes_are_shared() -> None:
    share_shaded_meshes()


class Recorded(NamedTuple):
    cells: CellCache
    env: WatchedEnv
    record: BinRecord
    results: list[PickResult]
    seconds: float  # simulated, at the bin's end
    links: dict[str, tuple[Any, Any]]  # where each is then, position and rotation
    file: RrdFile
    folder: Path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorded]:
    folder = tmp_path_factory.mktemp("recording")
    results: list[PickResult] = []
    with CellCache(scripted_cell) as cells:
        path = folder / "new" / "bin.rrd"
        record = evaluate_bin(CONFIG, 0, [Recording(path)], results.append, cells)
        env = cells.cell(CONFIG).env
        assert isinstance(env, WatchedEnv)
        simulation = env.simulation
        bodies = {name: simulation.model.body(name).id for name in LINKS}
        links = {
            name: (simulation.data.xpos[k].copy(), simulation.data.xmat[k].reshape(3, 3).copy())
            for name, k in bodies.items()
        }
        yield Recorded(cells, env, record, results, simulation.time, links, RrdFile(path), path.parent)


def numbers(record: BinRecord) -> dict[str, Any]:
    """Return everything in a record except for wall clock."""
    values = dataclasses.asdict(dataclasses.replace(record, wall=0.0, settle=0.0, render=0.0))
    for pick in values["picks"]:
        pick["t_compute"] = pick["t_concurrent"] = 0.0
    return values


def array(values: Any) -> Any:
    return np.array(values, np.float64)


# --- the whole file --------------------------------------------------------------------------------------------------


def test_a_recording_has_the_cell_the_frames_and_the_motion(recorded: Recorded) -> None:
    file = recorded.file
    assert file.timelines == {"time", "pick"}
    links = {path.split("/")[3] for path in file.entities if path.startswith("/world/robot/")}
    assert links >= LINKS | {"gripper_base", "gripper_left_follower", "gripper_right_driver"}
    seen = {f"/world/seen/{name}" for name in ("cloud", "poses", "scores", "camera", "camera/image")}
    rest = {"/world/parts", "/world/grasp", "/log", "/force", "/gripper/closed", "/gripper/target"}
    assert file.entities >= seen | rest | {"/world/cell/bin/0", "/world/cell/tray/0", "/world/cell/base/0"}
    assert "/world/seen/segments" not in file.entities  # the oracle has none


def test_only_the_complete_file_remains(recorded: Recorded) -> None:
    assert [path.name for path in recorded.folder.iterdir()] == ["bin.rrd"]


def test_recording_changes_nothing(recorded: Recorded) -> None:
    assert recorded.env.watchers == ()  # the next bin is not recorded
    again = evaluate_bin(CONFIG, 0, cells=recorded.cells)
    assert recorded.record.delivered == 2
    assert numbers(again) == numbers(recorded.record)


# --- motion ----------------------------------------------------------------------------------------------------------


def test_every_control_step_is_there(recorded: Recorded) -> None:
    times = np.unique([time for time, _ in recorded.file.rows("/gripper/closed", "Scalars:scalars")])
    np.testing.assert_allclose(np.diff(times), CONTROL_PERIOD, atol=1e-6)
    assert (times[0], times[-1]) == pytest.approx((0.0, recorded.seconds))


def test_the_links_end_where_the_simulation_has_them(recorded: Recorded) -> None:
    for name, (position, rotation) in recorded.links.items():
        time, translation = recorded.file.rows(f"/world/robot/{name}", "Transform3D:translation")[-1]
        x, y, z, w = recorded.file.rows(f"/world/robot/{name}", "Transform3D:quaternion")[-1][1][0]
        assert time == pytest.approx(recorded.seconds)
        np.testing.assert_allclose(translation[0], position, atol=1e-6)
        np.testing.assert_allclose(matrix_from_quat([w, x, y, z]), rotation, atol=1e-6)


def test_parts_lie_in_the_bin_and_leave_it_one_by_one(recorded: Recorded) -> None:
    rows = recorded.file.rows("/world/parts", "InstancePoses3D:translations")
    shown = [array(row).reshape(-1, 3) for _, row in rows]
    assert len(shown[0]) == 2
    assert recorded.env.workspace.contains(shown[0]).all()
    scales = [array(row).reshape(-1, 3) for _, row in recorded.file.rows("/world/parts", "InstancePoses3D:scales")]
    assert not scales[-1].any()  # nothing is left; no pose at all would be drawn at the origin
    counts = [len(each) if scale.any() else 0 for each, scale in zip(shown, scales, strict=True)]
    assert counts == sorted(counts, reverse=True)
    assert set(counts) == {2, 1, 0}


def test_the_jaw_closes_and_the_contact_force_rises(recorded: Recorded) -> None:
    closed = array([row for _, row in recorded.file.rows("/gripper/closed", "Scalars:scalars")])
    force = array([row for _, row in recorded.file.rows("/force", "Scalars:scalars")])
    assert closed.min() < 0.05
    assert closed.max() > 0.2
    assert force[0] == 0.0
    assert force.max() > 5.0


# --- frames and decisions --------------------------------------------------------------------------------------------


def test_each_decision_has_its_frame_its_poses_and_its_grasp(recorded: Recorded) -> None:
    file = recorded.file
    assert [pick for pick, _ in file.rows("/world/seen/cloud", "Points3D:positions", "pick")] == [0, 1, 2]
    poses = [array(row).reshape(-1, 3) for _, row in file.rows("/world/seen/poses", "InstancePoses3D:translations")]
    parts = array(file.rows("/world/parts", "InstancePoses3D:translations")[0][1])
    for place in poses[0]:
        assert np.linalg.norm(parts - place, axis=1).min() < 1e-6  # the oracle's are the true ones
    labels = [row for _, row in file.rows("/world/seen/scores", "Points3D:labels")]
    assert labels[0] == ["1.00"] * len(poses[0])


def test_the_cloud_is_in_the_world_and_as_grey_as_the_image(recorded: Recorded) -> None:
    time, points = recorded.file.rows("/world/seen/cloud", "Points3D:positions")[0]
    rgba = array(recorded.file.rows("/world/seen/cloud", "Points3D:colors")[0][1]).astype(np.int64)
    points = array(points)
    assert time == 0.0
    assert 10_000 < len(points) <= 320 * 240
    floor = recorded.env.workspace.contains(points, margin=-0.003)
    assert 0.2 < floor.mean() <= 1.0
    red, green, blue = rgba >> 24, rgba >> 16 & 255, rgba >> 8 & 255
    assert (red == green).all()
    assert (red == blue).all()
    assert len(np.unique(red)) > 10


def test_a_grasp_is_drawn_from_its_decision_on_until_the_next_frame(recorded: Recorded) -> None:
    rows = recorded.file.rows("/world/grasp", "LineStrips3D:strips", "pick")
    drawn = [(int(pick), len(strips)) for pick, strips in rows]
    assert drawn == [(0, 0), (0, 7), (1, 0), (1, 7), (2, 0)]
    grasp = recorded.results[0].grasp
    assert grasp is not None
    strips = [array(strip) for strip in next(strips for _, strips in rows if strips)]
    np.testing.assert_allclose(strips[0][1], (grasp.T_world_grasp @ [0, 0, -0.04, 1])[:3], atol=1e-6)
    tips = [np.linalg.norm(strips[k][-1] - strips[k][0]) for k in (1, 4)]
    assert tips == pytest.approx([grasp.opening, grasp.width], abs=1e-6)


def test_outcomes_are_logged_when_they_are_known(recorded: Recorded) -> None:
    rows = recorded.file.rows("/log", "TextLog:text")
    assert [row for _, row in rows] == [["pick 0: delivered"], ["pick 1: delivered"]]
    first = recorded.results[0].t_motion
    assert [time for time, _ in rows] == pytest.approx([first, first + recorded.results[1].t_motion])
    assert [pick for pick, _ in recorded.file.rows("/log", "TextLog:text", "pick")] == [0, 1]


def test_abstentions_are_logged_as_such(recorded: Recorded, tmp_path: Path) -> None:
    env = recorded.env
    env.reset(seed=5)
    with Recording(tmp_path / "bin.rrd") as recording:
        recording.bin_settled(env)
        for number in range(2):
            recording.before_decision(env)
            decided: Any = SimpleNamespace(number=number, result=abstain())
            recording.after_decision(env, decided)
            env.look()
    file = RrdFile(tmp_path / "bin.rrd")
    texts = [f"pick {k}: nothing tried, no candidate" for k in range(2)]
    assert [row for _, (row,) in file.rows("/log", "TextLog:text", "pick")] == texts
    assert [row for _, (row,) in file.rows("/log", "TextLog:level")] == ["WARN", "WARN"]
    assert [pick for pick, _ in file.rows("/world/seen/poses", "InstancePoses3D:scales", "pick")] == [0, 1]
    assert not any(row for _, row in file.rows("/world/grasp", "LineStrips3D:strips"))


def test_one_cell_has_several_step_listeners(recorded: Recorded) -> None:
    class Counter:
        steps = 0

        def after_step(self, env: BinPickEnv) -> None:
            self.steps += 1

    env, counters = recorded.env, (Counter(), Counter())
    rest = np.append(env.simulation.target, 0.0).astype(np.float32)
    for counter in counters:
        env.watch(counter)
        env.step(rest)
    env.unwatch(counters[0])
    env.step(rest)
    env.unwatch(counters[1])
    env.step(rest)
    assert [counter.steps for counter in counters] == [2, 2]


# --- what cannot be recorded -----------------------------------------------------------------------------------------


def test_a_bin_that_fails_leaves_no_file(recorded: Recorded, tmp_path: Path) -> None:
    def fail(result: PickResult) -> None:
        raise FloatingPointError("the physics diverged")

    with CellCache(lambda config: recorded.cells.cell(CONFIG)) as cells:
        cells.close = lambda: None  # type: ignore[method-assign]  # the module's cell stays open
        with pytest.raises(BinError, match="the physics diverged"):
            evaluate_bin(CONFIG, 0, [Recording(tmp_path / "bin.rrd")], fail, cells)
    assert list(tmp_path.iterdir()) == []
    assert recorded.env.watchers == ()


def test_a_bin_that_fails_before_it_has_settled_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(FloatingPointError), Recording(tmp_path / "bin.rrd"):
        raise FloatingPointError
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_recorded_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"must end in \.rrd, got 'bin\.mp4'"):
        check_recording(Path("bin.mp4"))
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(ValueError, match=r"a recording is a file, but .*folder\.rrd is a folder"):
        check_recording(tmp_path / "folder.rrd")
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"no recording can be written to .*bin\.rrd: .*(exists|directory)"):
        check_recording(tmp_path / "file" / "bin.rrd")
    with pytest.raises(ValueError, match="must end in"):
        Recording(tmp_path / "bin.mp4")
    check_recording(tmp_path / "new" / "bin.rrd")
    assert list((tmp_path / "new").iterdir()) == []  # the trial leaves nothing

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr("policies.report.recording.importlib.import_module", missing)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "binpick\[viz\]"'):
        check_recording(tmp_path / "bin.rrd")
