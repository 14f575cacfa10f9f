"""The same bin in another cell: a noisier sensor, a narrower jaw, a camera farther away, less friction."""

import gymnasium as gym

import binpick_env  # noqa: F401 - registers the environments

CELLS = {
    "standard": {},
    "harsh sensor": {"sensor": "harsh"},
    "jaw of 60 mm": {"jaw": 0.06},
    "camera at 1.2 m, 10 mm off": {"camera_distance": 1.2, "hand_eye_mm": 10.0},
    "slippery parts": {"friction": 0.2},
}


def main(num_parts: int = 4) -> dict[str, float]:
    """Return the share of pixels with depth in each cell."""
    shares = {}
    for name, options in CELLS.items():
        env = gym.make("BinPick-v0", part="tee", num_parts=num_parts, perception="oracle", **options).unwrapped
        env.reset(seed=0)
        shares[name] = float((env.frame.depth > 0).mean())
        camera = env.frame.T_world_cam[:3, 3]
        print(f"{name}: {shares[name]:.1%} of the pixels have depth, the camera is reported at {camera.round(3)}")
        env.close()
    return shares


if __name__ == "__main__":
    main()
