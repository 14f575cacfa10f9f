"""What each command of the pages' shell lines must have printed and written, and options that make it quick."""

import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import counted
from binpick_env.observation import GeneralNoise
from binpick_env.parts import load_part
from perception.s3dis.presets import ROWS
from perception.segmentation.point_files import read_points
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.weights import SHIPPED, find_weights, load_record
from policies.frames import example_files
from policies.selection.selectors import load_selector
from tests.rerun_rows import rows_of

PARTS = 2  # in each bin and scene


@dataclass(frozen=True, kw_only=True)
class Line:
    """A command line that was run.

    Attributes:
        args: Options that the command read, an instance of its ``Arguments``.
        folder: Working directory.
        shown: What it printed.
    """

    args: Any
    folder: Path
    shown: str

    def numbers(self, name: str) -> Any:
        """Return the JSON file of this name in the command's folder."""
        return json.loads((self.out / name).read_text(encoding="utf-8"))

    @property
    def out(self) -> Path:
        """Folder of the results."""
        return self.folder / self.args.folder()

    def label_lines(self) -> list[str]:
        """Return the printed lines' first words, up to two spaces or a number."""
        return [line.split("  ")[0] for line in self.shown.splitlines()]


def check_example(line: Line) -> None:
    assert line.shown.splitlines() == [str(line.args.out / name) for name in example_files()]


def check_segment(line: Line) -> None:
    assert line.shown.startswith("points    500\n")
    assert len(read_points(line.out / "labels.txt").points) == 500
    assert (line.out / "report.html").exists()
    assert (line.out / "poses.json").exists() == line.args.poses


def check_perceive(line: Line) -> None:
    args = line.args
    if args.frames[0].parent.name == "demo":  # the frame of `binpick example`
        _check_demo(line)
        return
    assert line.shown.count("no part was found: there are no boundary points") == len(args.frames)
    # The frame shows an empty floor: that is a table, but no bin of a stated size.
    unlimited = args.no_bin or (args.bin_pose is None and not args.find_bin)
    assert line.shown.count("no bin limits the poses") == (len(args.frames) if unlimited else 0)
    if args.json is not None:
        assert [frame["poses"] for frame in json.loads(args.json.read_text(encoding="utf-8"))["frames"]] == [
            [] for _ in args.frames
        ]
    for folder in (args.overlay, args.out):
        if folder is not None:
            assert all((folder / f"{path.stem}_poses.png").exists() for path in args.frames)


def _check_demo(line: Line) -> None:
    if line.args.depth_scale is not None:
        assert "the depth seems to be in millimetres; multiply it by 0.001" in line.shown
        assert "no part was found" in line.shown
        return
    assert "no likely cause of lost parts" in line.shown
    assert sum(text.endswith("  yes") for text in line.shown.splitlines()) >= 9  # of 12 parts
    if line.args.overlay is not None:
        assert (line.folder / line.args.overlay / "depth_poses.png").exists()
    if line.args.bop is not None:
        assert len((line.folder / line.args.bop).read_text(encoding="utf-8").splitlines()) >= 10


def check_pick(line: Line) -> None:
    args = line.args
    if Path(args.part).suffix:
        assert f"{Path(args.part).name}: read as mm, d_max 62 mm, symmetry order 4" in line.shown
    if args.budget:
        _check_budget(line)
        return
    _check_run(line.out, args.perception, args.bins)
    assert {"AP", "GSR", "DR", "MPPH mean picks per hour", "numbers", "report", "picks"} <= set(line.label_lines())
    if args.video is not None:
        assert (line.folder / args.video).read_bytes()[4:8] == b"ftyp"
    if args.rerun is not None:
        rows = rows_of(line.folder / args.rerun)
        assert rows["/log"] == len(_picks(line.out))
        assert rows["/world/seen/segments"] == rows["/world/seen/cloud"] >= 1


def _check_run(out: Path, perception: str, bins: int) -> None:
    """Check numbers, page and list of a run of ``binpick pick``."""
    numbers = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert (numbers["bins"], numbers["parts_total"]) == (bins, PARTS * bins)
    assert numbers["config"]["perception"] == perception
    assert 1 <= numbers["delivered"] == numbers["successes"] <= numbers["attempts"]
    assert numbers["gsr"] == numbers["successes"] / numbers["attempts"]
    assert (numbers["ap"] is None) == (perception == "oracle")
    frames = json.loads((out / "bin_0000.json").read_text(encoding="utf-8"))["frames"]
    assert (frames[0]["segments"] is None) == (perception == "oracle")
    if perception == "gt_masks":
        assert numbers["ap"] == 1.0
    picks = _picks(out)
    assert sum(pick["outcome"] != "" for pick in picks) == numbers["attempts"]
    report = (out / "report.html").read_text(encoding="utf-8")
    assert report.count("src='data:image/webp;base64,") == len(picks)
    assert ("given" in report) == (perception != "learned")


def _picks(out: Path) -> list[dict[str, str]]:
    with (out / "picks.csv").open() as file:
        return list(csv.DictReader(file))


def _check_budget(line: Line) -> None:
    modes = ("oracle", "gt_masks", "learned")
    numbers = line.numbers("budget.json")
    assert set(numbers["costs"]) == {"pose", "segmentation", "both"}
    for mode in modes:
        _check_run(line.out / mode, mode, line.args.bins)
    assert "segmentation (gt_masks - learned)" in line.shown
    page = (line.out / "budget.html").read_text(encoding="utf-8")
    assert all(mode in page for mode in modes)


def check_assess(line: Line) -> None:
    labels = {"part", "rests", "seen", "grasps", "scenes", "picks", "lost", "time", "numbers", "advice", "report"}
    assert labels <= {text.split()[0] for text in line.shown.splitlines()}
    numbers = line.numbers("assessment.json")
    assert (numbers["perception"]["scenes"], numbers["picking"]["parts"]) == (line.args.scenes, PARTS * line.args.bins)
    assert set(numbers["seconds"]) == {"part", "scenes", "bins"}
    report = (line.out / "report.html").read_text(encoding="utf-8")
    assert report.count("at rest, seen from above at an angle") == len(numbers["rests"])
    assert report.count("src='data:image/webp;base64,") >= 1


def check_compare(line: Line) -> None:
    first, second = line.args.runs
    assert [f"A  {first}", f"B  {second}", "differs: perception: oracle (A), gt_masks (B)"] == (
        line.shown.splitlines()[1:4]
    )
    for row in ("GSR, grasp success [%]", "DR, parts delivered [%]", "MPPH, picks per hour"):
        assert any(text.startswith(row) for text in line.shown.splitlines())
    assert "Settings that differ" in (line.folder / line.args.html).read_text(encoding="utf-8")


def check_generate_scenes(line: Line) -> None:
    assert line.shown.splitlines()[-1] == f"{counted(line.args.count, 'scene')} in {line.args.folder()}"
    scenes = [BoundaryScene.load(path) for path in sorted(line.out.glob("scene_*.npz"))]
    assert len(scenes) == line.args.count
    for scene in scenes:
        assert len(scene.T_cam_parts) == len(scene.visible_fractions) == PARTS
        assert set(np.unique(scene.instance_ids)) <= {-1, 0, 1}


def check_train_segmentation(line: Line) -> None:
    kept = {"weights.safetensors", "weights.json", "log.jsonl", "checkpoint.safetensors", "ap.svg"}
    names = {path.name for path in line.out.iterdir()}
    assert kept <= names, names
    assert any(name.startswith("events.out.tfevents") for path in line.out.rglob("*") if (name := path.name))
    (part,) = line.args.part
    found = find_weights(load_part(part).model)
    assert f"installed {found.path} " in line.shown
    assert found.training == "own"
    record = load_record(found.path)
    assert record["steps"] >= 1
    assert record["initial"]["parts"] == load_record(SHIPPED / "general.safetensors")["parts"]
    assert [source["scenes"] for source in record["trained_on"]] == [1]
    assert ("scene_minutes" in record) == ("making scenes in" in line.shown) == (line.args.scenes == ())


def check_evaluate_segmentation(line: Line) -> None:
    numbers = line.numbers("results.json")
    assert (numbers["scenes"], numbers["seed"]) == (line.args.count, line.args.seed)
    assert 0.4 < numbers["ap75"] <= numbers["ap50"] <= 1
    assert all(low <= numbers["ap"] <= high for low, high in [numbers["intervals"]["ap"]])
    assert {"", "AP", "AP50", "AP75", "AP25", "visible", "a scene", "clutter", "numbers"} <= set(line.label_lines())
    assert "paper, real Part A" in line.shown
    assert (line.out / "report.html").exists() == line.args.html


def check_evaluate_pose(line: Line) -> None:
    numbers = line.numbers("results.json")
    assert (numbers["scenes"], numbers["seed"]) == (line.args.count, line.args.seed)
    for name in ("recognition_rate", "recall", "precision"):
        assert 0.4 < numbers[name] <= 1
    assert numbers["translation_mm"]["median"] < 1
    assert {"recognition rate", "recall", "precision"} <= set(line.label_lines())


def check_train_selector(line: Line) -> None:
    method = type(line.args).__name__.lower()
    path = line.folder / line.args.folder(method) / "selector.safetensors"
    assert f"kept in {path.relative_to(line.folder)}" in line.shown
    load_selector(str(path))
    assert ("on held-out bins: " in line.shown) == (method == "bandit")


def check_evaluate_selector(line: Line) -> None:
    args = line.args
    numbers = json.loads((line.folder / args.job().out / "selectors.json").read_text(encoding="utf-8"))
    assert len(numbers["selectors"]) == len(args.selectors)
    for result in numbers["selectors"].values():
        assert 0 <= result["dr"] <= 1
    assert numbers["best_heuristic"] == "weighted"
    assert "best heuristic" in line.shown
    assert "hindsight (bound)" in line.shown


def check_fit_noise(line: Line) -> None:
    noise = GeneralNoise.load(line.folder / line.args.json)
    assert noise.provenance["bins"] == line.args.bins == 1
    assert len(noise.provenance["parts"]) == 1
    assert "rates on parts left out of the fit" in line.shown
    assert f"kept in {line.args.json}" in line.shown
    assert len(list(line.out.glob("bin_*.json"))) == 1


def check_synthesize(line: Line) -> None:
    assert f"{counted(line.args.rooms, 'room')} in {line.args.out}" in line.shown
    rooms = list((line.folder / line.args.out).glob("Area_*/*/Annotations"))
    assert len(rooms) == line.args.rooms
    assert all(list(room.glob("wall_*.txt")) for room in rooms)


def check_prepare(line: Line) -> None:
    found = list((line.folder / line.args.out).rglob("*.npz"))
    assert len(found) == len(list((line.folder / line.args.raw).glob("Area_*/*/Annotations")))
    assert f"{counted(len(found), 'room')} of " in line.shown


def check_train_row(line: Line) -> None:
    path = line.args.out / "weights.safetensors"
    assert f"weights   {path}" in line.shown
    assert load_record(line.folder / path)["steps"] == line.args.steps


def check_evaluate_row(line: Line) -> None:
    assert "last row: 1 room of" in line.shown  # of Area 5
    assert {"SGPN (PointNet, colour)", "dgcnn-new-colour"} <= set(line.label_lines())


def check_table(line: Line) -> None:
    assert {"SGPN (PointNet, colour)", *ROWS} <= set(line.label_lines())
    assert "gain on sgpn-colour" in line.shown
    records = list((line.folder / line.args.out).rglob("weights.safetensors"))
    assert len(records) == len(ROWS) * line.args.seeds


def check_soak(line: Line) -> None:
    assert line.numbers("soak.json")["kinds"].keys() == {"env"}
    assert {"env", "numbers"} <= set(line.label_lines())
    assert "  steps   " in line.shown


@dataclass(frozen=True, kw_only=True)
class Tiny:
    """How a command of a shell line is run and checked.

    Attributes:
        options: Values that replace those of the line, or are added to them.
        check: Fails unless the command did what its page says.
    """

    options: Mapping[str, object]
    check: Callable[[Line], None]


BINS = {"--bins": 1, "--min-parts": PARTS, "--max-parts": PARTS, "--width": 640, "--height": 480}
SCENES = {"--count": 2, "--workers": 1} | {name: value for name, value in BINS.items() if name != "--bins"}
NETWORK = {"--steps": 1, "--points": 64, "--batch": 2, "--held-out": 1}
TINY = {
    "pick": Tiny(options={**BINS, "--video-limit": 1}, check=check_pick),
    "assess": Tiny(options={**BINS, "--scenes": 1, "--workers": 1}, check=check_assess),
    "compare": Tiny(options={}, check=check_compare),
    "perceive": Tiny(options={}, check=check_perceive),
    "example": Tiny(options={}, check=check_example),
    "segment": Tiny(options={}, check=check_segment),
    "generate-scenes": Tiny(options=SCENES, check=check_generate_scenes),
    "train-segmentation": Tiny(
        options={
            "--minutes": 0.001,
            "--count": 2,
            "--workers": 1,
            "--held-out": 1,
            "--batch": 1,
            "--threads": 1,
            "--install": True,
        },
        check=check_train_segmentation,
    ),
    "evaluate-segmentation": Tiny(options={**SCENES, "--count": 1}, check=check_evaluate_segmentation),
    "evaluate-pose": Tiny(options={**SCENES, "--count": 1}, check=check_evaluate_pose),
    "train-selector bandit": Tiny(
        options={**BINS, "--bins": 2, "--workers": 1, "--epochs": 2}, check=check_train_selector
    ),
    "train-selector ppo": Tiny(
        options={name: value for name, value in BINS.items() if name != "--bins"}
        | {"--workers": 1, "--picks": 4, "--rollout": 4},
        check=check_train_selector,
    ),
    "evaluate-selector": Tiny(options=BINS, check=check_evaluate_selector),
    # In the full image, which a small generated part needs.
    "fit-noise": Tiny(options={"--bins": 1, "--min-parts": 4, "--max-parts": 4}, check=check_fit_noise),
    "s3dis synthesize": Tiny(options={"--rooms": 6, "--density": 15, "--workers": 1}, check=check_synthesize),
    "s3dis prepare": Tiny(options={"--workers": 1}, check=check_prepare),
    "s3dis train": Tiny(options={**NETWORK, "--threads": 1}, check=check_train_row),
    "s3dis evaluate": Tiny(options={"--workers": 1}, check=check_evaluate_row),
    "soak": Tiny(options={"--kind": "env", "--count": 1, "--resets": 0}, check=check_soak),
    "s3dis-table": Tiny(options={**NETWORK, "--seeds": 1, "--workers": 1}, check=check_table),
}
