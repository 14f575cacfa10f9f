"""Settings: what they mean, and what they refuse."""

from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from binpick_env.config import BinConfig, CameraConfig, CellConfig, ContactConfig, RobotConfig, TrayConfig
from perception.geometry import transform_points


def test_the_workspace_is_the_bins_pose_and_inner_box() -> None:
    workspace = BinConfig(inner_size=(0.4, 0.2, 0.1), wall=0.03, position=(0.6, 0.1), yaw=np.pi / 2).workspace()
    np.testing.assert_array_equal(workspace.inner_size, (0.4, 0.2, 0.1))
    corner_world = transform_points(workspace.T_world_bin, np.array([[0.2, 0.1, 0.0]]))[0]
    np.testing.assert_allclose(corner_world, (0.6 - 0.1, 0.1 + 0.2, 0.03), atol=1e-12)
    np.testing.assert_allclose(workspace.T_world_bin[:3, 2], (0, 0, 1), atol=1e-12)


def test_the_standard_bin() -> None:
    """0.36 x 0.26 x 0.12 m inside, walls thick enough that nothing tunnels."""
    assert BinConfig().inner_size == (0.36, 0.26, 0.12)
    assert BinConfig().wall >= 0.02


def test_focal_length_scales_with_the_image() -> None:
    assert CameraConfig().focal_px == 2400.0
    assert CameraConfig(width=640, height=480).focal_px == 1200.0


@pytest.mark.parametrize("kind", [BinConfig, CameraConfig, CellConfig, ContactConfig, RobotConfig, TrayConfig])
def test_settings_are_frozen_and_given_by_name(kind: type) -> None:
    config = kind()
    name = fields(config)[0].name
    with pytest.raises(FrozenInstanceError):
        setattr(config, name, None)
    with pytest.raises(TypeError, match="positional"):
        kind(getattr(config, name))
    assert config == kind()
    assert hash(config) == hash(kind())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BinConfig(inner_size=(0.3, 0.0, 0.1)), r"inner_size must be positive, got \(0\.3, 0\.0, 0\.1\)"),
        (lambda: BinConfig(wall="thick"), "wall must be float, got 'thick'"),  # type: ignore[arg-type]
        (lambda: CellConfig(bin=(0.3, 0.2, 0.1)), r"bin must be BinConfig, got \(0\.3"),  # type: ignore[arg-type]
        (lambda: BinConfig(position=(np.nan, 0.0)), r"position must be finite, got \(nan, 0\.0\)"),
        (lambda: BinConfig(yaw=np.inf), "yaw must be finite, got inf"),
        (lambda: ContactConfig(solref=(np.nan, 1.0)), r"solref must be finite, got \(nan, 1\.0\)"),
        (lambda: BinConfig(wall=0.001), r"wall must be at least 0\.005 m, got 0\.001"),
        (lambda: TrayConfig(inner_size=(0.0, 0.1, 0.1)), r"inner_size must be positive, got \(0\.0, 0\.1, 0\.1\)"),
        (lambda: TrayConfig(wall=0.0), r"wall must be positive, got 0\.0"),
        (lambda: RobotConfig(max_velocity=0.0), r"max_velocity must be positive, got 0\.0"),
        (lambda: RobotConfig(protective_stop=0.0), r"protective_stop must be positive, or None for no stop, got 0\.0"),
        (lambda: RobotConfig(max_jerk=0.0), r"max_jerk must be positive, or None for no limit, got 0\.0"),
        (lambda: RobotConfig(max_jerk=np.inf), "max_jerk must be finite, got inf"),
        (lambda: RobotConfig(jaw=0.0), r"jaw must be over 0 and at most 0\.085 m, the 2F-85's stroke, got 0\.0"),
        (lambda: RobotConfig(jaw=0.1), r"jaw must be over 0 and at most 0\.085 m, the 2F-85's stroke, got 0\.1"),
        (lambda: ContactConfig(condim=5), "condim must be 1, 3, 4 or 6, got 5"),
        (lambda: ContactConfig(friction=(-0.1, 0.0, 0.0)), r"friction must not be negative, got \(-0\.1"),
        (lambda: ContactConfig(joint_damping=-1.0), r"joint_damping must not be negative, got -1\.0"),
        (lambda: ContactConfig(sleep_tolerance=0.0), r"sleep_tolerance must be positive, got 0\.0"),
        (lambda: CellConfig(timestep=0.003), r"timestep must divide the control period of 0\.04 s, got 0\.003"),
        (lambda: CellConfig(timestep=0.0), r"timestep must divide the control period of 0\.04 s, got 0\.0"),
        (lambda: CameraConfig(width=8), "the image must be at least 16 x 16, got 8 x 960"),
        (lambda: CameraConfig(height=15), "the image must be at least 16 x 16, got 1280 x 15"),
        (lambda: CameraConfig(focal=0.0), r"focal must be positive, got 0\.0"),
        (lambda: CameraConfig(distance=0.2), r"distance must exceed 0\.2 m, got 0\.2"),
        (lambda: CameraConfig(backend="gl"), "backend must be one of rays, egl, raster, got 'gl'"),  # type: ignore[arg-type]
    ],
)
def test_nonsense_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
