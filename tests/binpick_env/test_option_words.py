"""Commands in messages have the options of the cell, and can be pasted."""

import shlex

from binpick_env.option_words import option_words, training_command
from binpick_env.options import CellOptions, scenes_of
from policies.commands import train_segmentation
from policies.commands.command_line import parse

OPTIONS = CellOptions(
    part="a clip.stl",
    unit="mm",
    symmetry="none",
    density=7800.0,
    bin=(0.3, 0.2, 0.1),
    jaw=0.05,
    max_acceleration=4.0,
    max_jerk=50.0,
    sensor="tof",
    camera_distance=1.0,
)


def test_standard_options_are_left_out() -> None:
    assert option_words(CellOptions()) == ["--part", "tee"]
    assert option_words(OPTIONS, only=("unit", "bin")) == ["--unit", "mm", "--bin", "0.3", "0.2", "0.1"]


def test_a_training_command_is_read_with_the_options_of_its_scenes() -> None:
    words = shlex.split(training_command(OPTIONS, "dgcnn-sgpn"))
    assert words[:4] == ["binpick", "train-segmentation", "--part", "a clip.stl"]
    read = parse(train_segmentation.Arguments, "train-segmentation", words[2:])
    assert (read.part, read.preset, read.install, read.minutes) == (("a clip.stl",), "dgcnn-sgpn", True, 60.0)
    for name in set(scenes_of(OPTIONS)) - {"part", "camera"}:
        assert getattr(read, name) == getattr(OPTIONS, name)
    assert read.camera_distance == 1.0
    assert "--preset" not in training_command(OPTIONS)
