"""What an installed wheel must be able to do, on its own.

Run from an empty directory, without pytest:
``PYTHONPATH=WHERE_THE_WHEEL_IS python -P smoke_test.py WHERE_THE_WHEEL_IS``.
"""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("binpick_env", "perception", "policies")
IMPORT_TIME = """
import sys, time
start = time.perf_counter()
import binpick_env
taken = time.perf_counter() - start
assert "torch" not in sys.modules, "importing binpick_env loads torch"
print(f"import binpick_env: {taken:.3f} s")
"""


def check_packages(where: Path) -> None:
    for name in PACKAGES:
        module = __import__(name)
        origin = Path(str(module.__file__)).resolve()
        assert origin.is_relative_to(where), f"{name} comes from {origin}, not from {where}"
        assert (origin.parent / "py.typed").is_file(), f"{name} ships no py.typed"


def check_command(where: Path) -> None:
    """Call the command that came with the wheel, in the folder this is run in, which is empty."""

    def binpick(*arguments: str) -> str:
        command = [sys.executable, str(where / "bin" / "binpick"), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    commands = [line.split()[0] for line in binpick().splitlines() if line.startswith("  ")]
    assert {"pick", "generate-scenes", "train-segmentation", "evaluate-pose", "bench"} <= set(commands), commands
    assert binpick("--version") == f"binpick {version('binpick')}\n"
    small = ("--min-parts", "1", "--max-parts", "1", "--width", "320", "--height", "240")
    assert binpick("generate-scenes", "--count", "1", *small) == "1 scene in runs/scenes-tee-0\n"
    assert Path("runs/scenes-tee-0/scene_00000.npz").exists()


def check_environment() -> None:
    import gymnasium as gym
    import numpy as np

    import binpick_env  # noqa: F401
    from binpick_env.config import CameraConfig

    camera = CameraConfig(width=320, height=240)
    env = gym.make("BinPick-v0", num_parts=2, perception="oracle", sensor="none", camera=camera)
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert info["total"] == 2
    rest = np.append(observation["joint_pos"], 0.0).astype(np.float32)
    observation, reward, terminated, truncated, info = env.step(rest)
    assert env.observation_space.contains(observation)
    assert (reward, terminated, truncated) == (0.0, False, False)
    env.close()


def check_weights() -> None:
    """Load the network that came with the wheel: a cell that perceives by it compiles more than a test waits for."""
    from binpick_env.parts import load_part
    from perception.segmentation.predictor import SegmentationPredictor

    SegmentationPredictor.for_part(load_part("tee").model, device="cpu")


def main() -> None:
    where = Path(sys.argv[1]).resolve()
    subprocess.run([sys.executable, "-P", "-c", IMPORT_TIME], check=True)
    check_packages(where)
    check_command(where)
    check_environment()
    check_weights()
    print("smoke test passed")


if __name__ == "__main__":
    main()
