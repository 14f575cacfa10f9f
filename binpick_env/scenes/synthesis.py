"""Synthesis of labelled boundary scenes: parts settle in a bin; camera pose, light and sensor noise are random."""

import hashlib
import json
import logging
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from binpick_env.camera.appearance import draw_appearance
from binpick_env.camera.depth_camera import Capture, DepthCamera, default_pose
from binpick_env.camera.sensor import PRESETS
from binpick_env.camera.shading import Light
from binpick_env.cell.settle import drop_and_settle
from binpick_env.cell.simulation import Simulation
from binpick_env.config import AppearanceChoice, CameraConfig, CellConfig, SensorChoice, SensorPreset
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers, is_positive
from binpick_env.options import CellOptions
from binpick_env.part_limits import bin_capacity as bin_capacity
from binpick_env.parts.catalogue import CATALOGUE
from binpick_env.parts.families.generator import VERSION as GENERATOR_VERSION
from binpick_env.parts.families.names import is_generated, training_parts
from binpick_env.parts.part import Part
from binpick_env.parts.unit import Unit
from binpick_env.scenes.clutter import visible_fractions
from perception.boundary import extract_boundary
from perception.geometry import Floats, invert_transform, make_transform, rotation_about, transform_point_each
from perception.runtime.file_work import FolderWork
from perception.runtime.files import json_text
from perception.runtime.last_result import LastResult
from perception.segmentation.scene import SCENES_NOTE, BoundaryScene, SceneError
from perception.segmentation.surface import coarse_surface
from perception.shape import shape_signature
from perception.thickness import part_boundary

_log = logging.getLogger(__name__)
MANY_PARTS = "generated"  # stands for parts of all training families, for the training of one network for every part
SCENES_PER_PART = 4  # number of successive scenes of one part of `MANY_PARTS`
# Newer fields and their defaults.
_NEWER_FIELDS = {
    "symmetry": "detect",
    "density": None,
    "bin": None,
    "friction": None,
    "appearance": "clean",
    "symmetry_tolerance": None,
}
OLDER_SETTINGS = {"generator": 1}  # settings that folders of older versions lack
# Share of scenes that each preset sees.
MIXTURE: dict[SensorPreset, float] = {"good": 0.7, "harsh": 0.2, "none": 0.1}  # "mixed": structured light alone
FULL_MIXTURE: dict[SensorPreset, float] = {"good": 0.35, "stereo": 0.25, "tof": 0.1, "harsh": 0.2, "none": 0.1}  # "all"
_MIXTURES: dict[SensorChoice, dict[SensorPreset, float]] = {"mixed": MIXTURE, "all": FULL_MIXTURE}


@dataclass(frozen=True, kw_only=True)
class SceneConfig:
    """Configuration of synthetic scenes; a scene depends on it and on its index alone.

    Attributes:
        part: Name of a part, or path of a mesh file. :data:`MANY_PARTS` takes another generated part of the training
            families for every few scenes, as many parts as the bin holds, from ``num_parts``.
        unit: Length unit of a mesh file; the most plausible one by default.
        seed: Seed of all scenes; scene i is drawn from (seed, i).
        num_parts: Smallest and largest number of parts in a bin.
        sensor: Preset of the depth sensor's noise; "mixed" draws one of ``good``, ``harsh`` and ``none`` for each
            scene, mostly ``good``; "all" draws one of all presets.
        jitter: Whether camera pose and light are random; otherwise they are the cell's nominal ones.
        camera: Image size, focal length, distance and rendering backend of the camera.
        symmetry: Whether the rotational symmetry of a mesh file is looked for; "none" ignores it.
        density: Density of the part [kg/m^3]; the catalogue's, or aluminium's for a file, by default.
        bin: Length, width and height inside the bin [m]; those of the standard bin by default.
        friction: Sliding friction coefficient of parts, bin and tray; the cell's own by default.
        appearance: "varied" draws uneven light, blur, labels, worn edges and deviations from CAD for each scene.
        symmetry_tolerance: Largest deviation of a mesh file's surface from itself under a symmetry [m]; 0.5 % of its
            diameter by default.
    """

    part: str = "tee"
    unit: Unit | None = None
    seed: int = 0
    num_parts: tuple[int, int] = (20, 30)
    sensor: SensorChoice = "good"
    jitter: bool = True
    camera: CameraConfig = field(default_factory=CameraConfig)
    symmetry: Literal["detect", "none"] = "detect"
    density: float | None = None
    bin: tuple[float, float, float] | None = None
    friction: float | None = None
    appearance: AppearanceChoice = "clean"
    symmetry_tolerance: float | None = None

    def __post_init__(self) -> None:
        low, high = self.num_parts
        if not 0 <= low <= high:
            raise ValueError(f"num_parts must be (smallest, largest) from 0 up, got {self.num_parts}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        if self.sensor not in (*PRESETS, *_MIXTURES):
            raise ValueError(f"sensor must be one of {', '.join((*PRESETS, *_MIXTURES))}, got {self.sensor!r}")
        if self.appearance not in get_args(AppearanceChoice):
            raise ValueError(f"appearance must be clean or varied, got {self.appearance!r}")
        self.options()

    def options(self) -> CellOptions:
        """Return part, bin and friction as options of a cell, whose sensor and image are the default ones."""
        return CellOptions(
            part=self.part,
            unit=self.unit,
            symmetry=self.symmetry,
            symmetry_tolerance=self.symmetry_tolerance,
            density=self.density,
            bin=self.bin,
            camera_distance=self.camera.distance,
            friction=self.friction,
        )

    def cell(self) -> CellConfig:
        """Return the cell that the scenes are captured in."""
        return replace(self.options().cell(), camera=self.camera)

    def at(self, index: int) -> "SceneConfig":
        """Return the configuration of scene ``index``, whose part is a single one."""
        return _of_many(self, index // SCENES_PER_PART) if self.part == MANY_PARTS else self


class CapturedScene(NamedTuple):
    """A labelled scene and the capture that it was extracted from."""

    scene: BoundaryScene
    capture: Capture


@dataclass(frozen=True, eq=False)
class _SceneSetup:
    """Part, simulation and camera of a configuration, reused from scene to scene; each scene resets them."""

    part: Part
    simulation: Simulation
    camera: DepthCamera


@LastResult
def _scene_setup(config: SceneConfig) -> _SceneSetup:
    part = config.options().load_part()
    simulation = Simulation(config.cell(), part, max(config.num_parts[1], 1))
    workspace = simulation.config.bin.workspace()
    camera = DepthCamera(simulation.model, config.camera, workspace, simulation.part_of_geom, threads=1)
    return _SceneSetup(part, simulation, camera)


@lru_cache(maxsize=1)
def _of_many(config: SceneConfig, number: int) -> SceneConfig:
    """Return the configuration of the scenes of generated part ``number``."""
    return with_room(replace(config, part=training_parts(number + 1)[number]))


def with_room(config: SceneConfig) -> SceneConfig:
    """Return a configuration with at most as many parts as fit into the bin; see :func:`bin_capacity`."""
    low, high = config.num_parts
    room = bin_capacity(config.options().load_part(), config.cell().bin.inner_size)
    return replace(config, num_parts=(min(low, room), min(high, room)))


def make_scene(config: SceneConfig, index: int) -> CapturedScene:
    """Simulate, capture and label scene ``index``; the result does not depend on other scenes or on the process."""
    rng = np.random.default_rng(np.random.SeedSequence([config.seed, index]))
    config = config.at(index)
    setup = _scene_setup(config)
    simulation, camera, model = setup.simulation, setup.camera, setup.part.model
    count = int(rng.integers(config.num_parts[0], config.num_parts[1] + 1))
    drop_and_settle(simulation, count, rng)
    sensor = _draw_sensor(config.sensor, rng)
    camera.move(_draw_pose(camera, rng) if config.jitter else default_pose(camera.workspace, config.camera.distance))
    light = draw_light(rng) if config.jitter else None
    appearance = draw_appearance(rng) if config.appearance == "varied" else None
    capture = camera.capture(simulation.data, rng, sensor, light, appearance)
    boundary = extract_boundary(capture.frame, camera.workspace, part_boundary(model))
    T_world_parts = simulation.part_poses()[:count]
    T_cam_parts = invert_transform(camera.T_world_cam) @ T_world_parts
    scene = BoundaryScene(
        part=model.name,
        d_max=model.d_max,
        boundary=boundary,
        surface=coarse_surface(capture.frame, camera.workspace, model.d_max),
        K=capture.frame.K,
        instance_ids=capture.measured_ids[boundary.pixels[:, 1], boundary.pixels[:, 0]],
        T_cam_parts=T_cam_parts,
        centres_cam=transform_point_each(T_cam_parts, model.centre),
        visible_fractions=visible_fractions(capture, model.mesh, T_world_parts),
        signature=np.array(shape_signature(model)),
    )
    return CapturedScene(scene, capture)


def draw_light(rng: np.random.Generator) -> Light:
    """Draw a light direction within 45 degrees of the camera's axis, intensities, albedos and ambient occlusion."""
    tilt, turn = np.arccos(rng.uniform(np.cos(np.pi / 4), 1.0)), rng.uniform(0.0, 2 * np.pi)
    ambient = rng.uniform(0.15, 0.4)
    return Light(
        to_light=(float(np.sin(tilt) * np.cos(turn)), float(np.sin(tilt) * np.sin(turn)), -float(np.cos(tilt))),
        ambient=float(ambient),
        diffuse=float(1.0 - ambient),
        part_albedo=float(rng.uniform(0.6, 0.9)),
        container_albedo=float(rng.uniform(0.25, 0.6)),
        falloff=float(rng.uniform(0.0, 0.8)),
        occlusion=float(rng.uniform(0.6, 0.95)),
        radius=float(rng.uniform(0.004, 0.007)),
    )


def _draw_sensor(sensor: SensorChoice, rng: np.random.Generator) -> SensorPreset:
    """Return the preset that a scene is seen by; a mixture draws one number."""
    if sensor == "mixed" or sensor == "all":
        mixture = _MIXTURES[sensor]
        return list(mixture)[int(rng.choice(len(mixture), p=list(mixture.values())))]
    return sensor


def _draw_pose(camera: DepthCamera, rng: np.random.Generator) -> Floats:
    """Draw ``T_world_cam``: tilted by up to 4 deg, up to 5 cm nearer or farther, and shifted by up to 1 cm."""
    workspace = camera.workspace
    distance = camera.config.distance + rng.uniform(-0.05, 0.05)
    axis = np.append(rng.normal(size=2), 0.0)
    tilt = make_transform(rotation_about(axis, rng.uniform(0.0, np.deg2rad(4.0))))
    aside = make_transform(translation=np.append(rng.uniform(-0.01, 0.01, size=2), 0.0))
    nominal = default_pose(workspace, distance)
    # The camera is tilted about the bin's centre, so that the whole bin stays in the image.
    return workspace.T_world_bin @ aside @ tilt @ invert_transform(workspace.T_world_bin) @ nominal


def scene_path(folder: Path, index: int) -> Path:
    """Return the path of the file of scene ``index``."""
    return folder / f"scene_{index:05d}.npz"


def generate_scenes(config: SceneConfig, count: int, folder: Path, workers: Workers = 1) -> Iterator[int]:
    """Write scenes 0 to ``count - 1`` and yield each index once its file exists; intact files are kept.

    Args:
        config: Configuration of the scenes.
        count: Number of scenes.
        folder: Folder of the scenes' files; it must not hold scenes of another configuration.
        workers: Number of worker processes, or a cluster.

    Raises:
        ValueError: The folder holds scenes of another configuration, there is no such part, or ``count`` or
            ``workers`` is not positive.
        FileNotFoundError: The part's file does not exist.
        WorkerError: A process was killed; every finished scene is kept.
    """
    if count < 1 or not is_positive(workers):
        raise ValueError(f"count and workers must be at least 1, got {count} and {workers}")
    config.at(0).options().load_part()  # before the folder gets a configuration
    ensure_folder_config(config, folder)
    missing = []
    for index in range(count):
        if _is_whole(scene_path(folder, index)):
            yield index
        else:
            missing.append(index)
    yield from map_indices(FolderWork(partial(_write_scene, config), folder), missing, workers)


def ensure_folder_config(config: SceneConfig, folder: Path) -> None:
    """Write the configuration into the folder, or compare it with the one there; see `ensure_same_config`."""
    ensure_same_config(folder / SCENES_NOTE, scene_settings(config), "scenes", assumed=OLDER_SETTINGS)


def scene_settings(config: SceneConfig) -> dict[str, Any]:
    """Return the configuration as JSON types, with the SHA-256 of a mesh file or the version of the part generator.

    Newer fields are left out where they have their defaults, so that folders of older versions can be resumed.
    """
    values: dict[str, Any] = json.loads(json_text(asdict(config)))
    for name, default in _NEWER_FIELDS.items():
        if values[name] == default:
            del values[name]
    if config.part == MANY_PARTS or is_generated(config.part):
        values["generator"] = GENERATOR_VERSION
    elif config.part not in CATALOGUE:
        values["file"] = hashlib.sha256(Path(config.part).read_bytes()).hexdigest()
    return values


def is_of_part(stored: Mapping[str, Any], config: SceneConfig) -> bool:
    """Tell whether stored scenes may show the part of a configuration.

    Files are compared by their content, or by their names where an older folder does not tell it. Scenes of
    `MANY_PARTS` show every generated part.

    Args:
        stored: Settings of the stored scenes, as :func:`scene_settings` returns them.
        config: Configuration of other scenes.
    """
    if stored["part"] == MANY_PARTS and is_generated(config.part):
        return True
    if stored.get("file") is not None:
        return bool(stored["file"] == scene_settings(config).get("file"))
    return Path(str(stored["part"])).stem == Path(config.part).stem


def _is_whole(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        BoundaryScene.load(path)
    except SceneError as error:
        _log.warning("made again: %s", error)
        return False
    return True


def _write_scene(config: SceneConfig, folder: Path, index: int) -> int:
    make_scene(config, index).scene.save(scene_path(folder, index))
    return index
