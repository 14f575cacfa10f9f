"""The jobs that are killed: short, resumable, and the same bits in every run."""

from dataclasses import dataclass
from pathlib import Path

_FEW = ("--min-parts", "2", "--max-parts", "2", "--width", "640", "--height", "480")
_OUT, _SCENES = "{out}", "{scenes}"


@dataclass(frozen=True, kw_only=True)
class KilledJob:
    """A command of binpick that writes into a folder.

    Attributes:
        name: Name of the job, which is that of its command.
        words: Words after ``binpick``, with places for the folder of the results and for that of the scenes.
    """

    name: str
    words: tuple[str, ...]

    @property
    def needs_scenes(self) -> bool:
        """Whether it reads the scenes of the job that generates them."""
        return _SCENES in self.words

    def command(self, out: Path, scenes: Path) -> list[str]:
        """Return the words after ``binpick`` for a folder of results."""
        places = {_OUT: str(out), _SCENES: str(scenes)}
        return [places.get(word, word) for word in self.words]


SCENES = KilledJob(
    name="generate-scenes", words=("generate-scenes", "--count", "4", "--workers", "1", *_FEW, "--out", _OUT)
)
JOBS = (
    KilledJob(
        name="pick",
        words=("pick", "--bins", "3", *_FEW, "--perception", "oracle", "--no-html", "--out", _OUT),
    ),
    SCENES,
    KilledJob(
        name="train-segmentation",
        words=(
            *("train-segmentation", "--part", "tee", "--scenes", _SCENES, "--held-out", "1", "--batch", "1"),
            *("--threads", "1", "--no-tensorboard", "--install", "False", "--steps", "10", "--initial", "none"),
            *("--out", _OUT),
        ),
    ),
    KilledJob(
        name="evaluate-pose",
        words=("evaluate-pose", "--count", "3", "--workers", "1", *_FEW, "--perception", "gt_masks", "--out", _OUT),
    ),
    KilledJob(
        name="train-selector",
        words=(
            *("train-selector", "bandit", "--bins", "3", "--workers", "1", *_FEW, "--perception", "oracle"),
            *("--epochs", "2", "--out", _OUT),
        ),
    ),
)
