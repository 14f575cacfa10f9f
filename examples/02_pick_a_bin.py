"""The scripted picker empties a small bin, by the rules of `binpick pick`."""

import gymnasium as gym

import binpick_env  # noqa: F401 - registers the environments
from policies.grasping.outcomes import PickResult
from policies.picking.episode import BinResult, run_bin
from policies.picking.scripted import ScriptedPicker


def main(num_parts: int = 4, perception: str = "oracle") -> BinResult:
    """Return what came of the bin."""
    env = gym.make("BinPick-v0", part="tee", num_parts=num_parts, perception=perception).unwrapped

    def report(result: PickResult) -> None:
        print(f"  {result.outcome or result.abstention}, motion {result.t_motion:.1f} s")

    result = run_bin(env, ScriptedPicker(env), seed=0, on_pick=report)
    print(f"{result.delivered} of {result.parts_total} parts delivered, the bin ended: {result.termination}")
    env.close()
    return result


if __name__ == "__main__":
    main(num_parts=8, perception="learned")
