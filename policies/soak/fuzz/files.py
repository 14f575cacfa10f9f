"""Malformed files of other programs: point clouds in PCD, PLY and text, calibrations, depth images."""

import json
import shutil
from pathlib import Path

import numpy as np

from perception.capture import ReadOptions, read_frame
from perception.segmentation.point_files import read_points
from policies.soak.fuzz.damage import choose, damaged_bytes, damaged_json, damaged_text
from policies.soak.fuzz.grammar import Case
from policies.soak.fuzz.samples import Samples

_CALIBRATIONS = (
    {"fx": 300, "fy": 300, "cx": 79.5, "cy": 59.5, "width": 160, "height": 120, "depth_scale": 0.0001},
    {"width": 160, "height": 120, "intrinsic_matrix": [300, 0, 0, 0, 300, 0, 79.5, 59.5, 1]},
    {"K": [[300, 0, 79.5], [0, 300, 59.5], [0, 0, 1]], "metres_per_unit": 0.0001},
    {"0": {"cam_K": [300, 0, 79.5, 0, 300, 59.5, 0, 0, 1], "depth_scale": 0.1}},
    {"width": 160, "height": 120, "fx": 300, "fy": 300, "ppx": 79.5, "ppy": 59.5, "coeffs": [0, 0, 0, 0, 0]},
)
_YAML = """image_width: 160
image_height: 120
camera_name: depth
camera_matrix:
  rows: 3
  cols: 3
  data: [300, 0, 79.5, 0, 300, 59.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0, 0, 0, 0, 0]
"""


def cloud(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """A point cloud with a damaged header, damaged lines or damaged bytes, read as a frame or as points."""
    name = choose(rng, ("ascii.pcd", "binary.pcd", "ascii.ply", "binary.ply", "cloud.xyz"))
    raw = (samples.folder / name).read_bytes()
    if rng.random() < 0.35:
        raw = damaged_bytes(rng, raw)
    else:
        mark = next((raw.find(word) for word in (b"end_header", b"DATA ") if word in raw), -1)
        end = raw.find(b"\n", mark) + 1 if mark >= 0 else len(raw)
        raw = damaged_text(rng, raw[:end].decode()).encode() + raw[end:]
    path = folder / (name if rng.random() < 0.9 else choose(rng, ("cloud.ply", "cloud.pcd", "cloud.txt", "cloud.npy")))
    path.write_bytes(raw)
    if name == "cloud.xyz" or rng.random() < 0.5:
        return lambda: read_points(path)
    grid = choose(rng, (None, (160, 120), (0, 0), (-1, 3), (10**9, 10**9)))
    K = choose(rng, (None, samples.frame().K))
    return lambda: read_frame(path, calibration=K, options=ReadOptions(grid=grid))


def calibration(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """A calibration in JSON or YAML with damaged values or text, for a depth image."""
    if rng.random() < 0.3:
        path, text = folder / "camera.yaml", damaged_text(rng, _YAML)
    else:
        path, facts = folder / "camera.json", choose(rng, _CALIBRATIONS)
        text = damaged_text(rng, json.dumps(facts)) if rng.random() < 0.3 else json.dumps(damaged_json(rng, facts))
    path.write_text(text, encoding="utf-8")
    return lambda: read_frame(samples.folder / "small_depth.png", calibration=path)


def image(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """A frame of our own as NPZ or as JSON with images, with damage to one of the files."""
    if rng.random() < 0.4:
        path = folder / "frame.npz"
        path.write_bytes(damaged_bytes(rng, (samples.folder / "small.npz").read_bytes()))
        return lambda: read_frame(path)
    names = ("small.json", "small_depth.png", "small_grey.png")
    for name in names:
        shutil.copyfile(samples.folder / name, folder / name)
    name = choose(rng, names)
    raw = (folder / name).read_bytes()
    if name == "small.json":
        raw = json.dumps(damaged_json(rng, json.loads(raw))).encode()
    else:
        raw = damaged_bytes(rng, raw)
    (folder / name).write_bytes(raw)
    return lambda: read_frame(folder / "small.json")
