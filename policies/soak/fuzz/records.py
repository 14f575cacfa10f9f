"""Malformed files of our own: scenes, weights, selectors and records of bins."""

import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.scene import BoundaryScene
from policies.evaluation.records import load_record
from policies.selection.selectors import load_selector
from policies.soak.fuzz.damage import choose, damaged_array, damaged_bytes, damaged_json, damaged_text
from policies.soak.fuzz.grammar import Case
from policies.soak.fuzz.samples import Samples


def scene(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """A scene file with damaged arrays, without some, or with damaged bytes."""
    path = folder / "scene.npz"
    raw = (samples.folder / "scene.npz").read_bytes()
    if rng.random() < 0.4:
        path.write_bytes(damaged_bytes(rng, raw))
    else:
        with np.load(io.BytesIO(raw)) as stored:
            arrays = {name: stored[name] for name in stored.files}
        for name in rng.choice(list(arrays), int(rng.integers(1, 3)), replace=False):
            arrays[name] = damaged_array(rng, arrays[name])
            if rng.random() < 0.2:
                del arrays[name]
        np.savez_compressed(path, **arrays)
    return lambda: BoundaryScene.load(path)


def weights(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """Weights of a segmentation network, or a selector, with a damaged header, damaged tensors or damaged bytes."""
    name = choose(rng, ("weights", "selector"))
    path = folder / f"{name}.safetensors"
    raw = (samples.folder / path.name).read_bytes()
    if rng.random() < 0.5:
        path.write_bytes(damaged_bytes(rng, raw))
    else:
        path.write_bytes(_with_other_header(rng, raw))
    if rng.random() < 0.5:
        shutil.copyfile(samples.folder / f"{name}.json", folder / f"{name}.json")
    if name == "selector":
        return lambda: load_selector(str(path))
    return lambda: SegmentationPredictor.from_file(path)


def record(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """The record of a bin with damaged values or damaged text."""
    path = folder / "bin_0000.json"
    text = (samples.folder / "pick" / path.name).read_text(encoding="utf-8")
    path.write_text(damaged_record(rng, text), encoding="utf-8")
    return lambda: load_record(path)


def damaged_record(rng: np.random.Generator, text: str) -> str:
    """Return a JSON text with damaged values, mostly, or damaged as text."""
    if rng.random() < 0.3:
        return damaged_text(rng, text)
    return json.dumps(damaged_json(rng, json.loads(text)))


def _with_other_header(rng: np.random.Generator, raw: bytes) -> bytes:
    """Return a safetensors file whose JSON header has damaged values."""
    size = int.from_bytes(raw[:8], "little")
    header: Any = json.loads(raw[8 : 8 + size])
    facts = header["__metadata__"]
    if rng.random() < 0.6 and "record" in facts:
        facts["record"] = json.dumps(damaged_json(rng, json.loads(facts["record"])))
    else:
        header = damaged_json(rng, header)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + raw[8 + size :]
