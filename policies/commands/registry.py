"""The commands that there are. It loads none of them, so that listing them is quick."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of ``binpick``."""

    name: str  # as it is typed, with hyphens
    group: str  # heading that it is listed under
    summary: str  # one line
    module: str  # dotted path; its ``main`` takes the arguments that follow the name, and returns the exit code


def _command(name: str, group: str, summary: str) -> Command:
    return Command(name=name, group=group, summary=summary, module=f"policies.commands.{name.replace('-', '_')}")


_PICK, _SEE, _SELECT, _ROOMS, _MEASURE = (
    "picking",
    "segmentation and poses",
    "grasp selectors",
    "rooms (S3DIS)",
    "speed, robustness, pictures",
)
COMMANDS = (
    _command("pick", _PICK, "pick bins of a part, print success rates with intervals, write a report"),
    _command("assess", _PICK, "assess a part on one page: perception, picks, what to do about it"),
    _command("compare", _PICK, "compare two runs of pick on the same bins, with paired intervals"),
    _command("perceive", _SEE, "find the poses of a part in frames of your camera, and why some are lost"),
    _command("example", _SEE, "copy a small frame with camera, bin and part, to try perceive on"),
    _command("segment", _SEE, "label the parts in a cloud of boundary points, without an image"),
    _command("generate-scenes", _SEE, "make labelled scenes to train the segmentation on"),
    _command("train-segmentation", _SEE, "train a segmentation network on labelled scenes"),
    _command("evaluate-segmentation", _SEE, "measure the segmentation's average precision on fresh scenes"),
    _command("evaluate-pose", _SEE, "measure recognition, recall and precision of poses on fresh scenes"),
    _command("evaluate-bin", _SEE, "measure how well a bin is found in frames of a camera whose pose is wrong"),
    _command("calibrate-poses", _SEE, "fit a pose's score to its chance of being right"),
    _command("train-selector", _SELECT, "train a grasp selector, by MaskablePPO or on logged attempts"),
    _command("evaluate-selector", _SELECT, "compare grasp selectors on the same bins"),
    _command("fit-noise", _SELECT, "fit a noise model of true poses to the errors of the learned perception"),
    _command("check-fast", _SELECT, "compare attempts made in full with the same ones in the fast training mode"),
    _command("s3dis", _ROOMS, "prepare rooms, train and evaluate a row of the paper's table 1"),
    _command("s3dis-table", _ROOMS, "train and evaluate all four rows of the paper's table 1"),
    _command("bench", _MEASURE, "measure how fast the cell, perception and the selection environment run"),
    _command("soak", _MEASURE, "look for crashes, leaks and half-written files in long runs"),
    _command("picture", _MEASURE, "draw a settled bin, or what perception makes of a frame"),
)
