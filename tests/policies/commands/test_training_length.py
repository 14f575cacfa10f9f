"""How long `binpick train-segmentation` trains, and how often it evaluates."""

import pytest

from perception.segmentation.training.loop import Length
from policies.commands import train_segmentation as train


def test_the_papers_preset_trains_200_epochs_unless_told_otherwise() -> None:
    args = train.Arguments(part=("bracket",), preset="paper")
    assert args.length(args.config(), 1000).steps == 100_000
    assert args.length(args.config(), 1000, world=4).steps == 25_000
    assert train.Arguments(preset="paper", steps=7).length(args.config(), 1000).steps == 7


def test_evaluations_are_a_sixth_of_the_training_apart_from_one_to_ten_minutes() -> None:
    for length, expected in (
        (Length(minutes=9.0), 1.5),
        (Length(minutes=2.0), 1.0),
        (Length(minutes=600.0), 10.0),
        (Length(steps=1200), 1200 / 60 / 6),
        (Length(steps=2), 1.0),
    ):
        assert train.Arguments(minutes=1.0).interval(length) == pytest.approx(expected)
    assert train.Arguments(evaluate_every=0.5).interval(Length(minutes=9.0)) == 0.5
