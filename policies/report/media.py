"""Pictures, film and recording of an evaluation's bins, made while the bins are picked."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from policies.evaluation.listeners import BinListener
from policies.report.pictures import Album
from policies.report.recording import Recording, check_recording
from policies.report.video import SPEED, Film, check_length, check_video


@dataclass(frozen=True, kw_only=True)
class BinMedia:
    """What is made of an evaluation's bins beside their records; a :class:`policies.evaluation.jobs.Job` takes it.

    Attributes:
        pictures: Whether pictures of every bin and decision are written beside the records.
        video: mp4 file that shows the first bin; None for no film.
        video_limit: Largest length of the film in simulated time [s].
        video_speed: Simulated seconds shown per second of film.
        recording: rrd file for Rerun's viewer that shows the first bin; None for no recording.
    """

    pictures: bool = True
    video: Path | None = None
    video_limit: float = 60.0
    video_speed: float = SPEED
    recording: Path | None = None

    def check(self, evaluations: int = 1) -> None:
        """Raise unless film and recording can be written.

        Args:
            evaluations: Number of evaluations that share these settings.

        Raises:
            ValueError: A file's name or folder is unusable, a film's length or speed has no meaning, or several
                evaluations would write the same file.
            ModuleNotFoundError: An extra is not installed; the text tells how to install it.
        """
        if evaluations > 1 and self.recording is not None:
            raise ValueError("a budget records none; leave out --rerun, or record one without --budget")
        if evaluations > 1 and self.video is not None:
            raise ValueError(
                "a budget is three evaluations and films none; leave out --video, or film one without --budget"
            )
        check_length(self.video_limit, self.video_speed)
        if self.video is not None:
            check_video(self.video, self.video_limit, self.video_speed)
        if self.recording is not None:
            check_recording(self.recording)

    def needs_bin(self, index: int) -> bool:
        """Return whether bin ``index`` is filmed or recorded, so that it is picked even if its record exists."""
        return index == 0 and (self.video is not None or self.recording is not None)

    def listeners(self, index: int, folder: Path) -> Sequence[BinListener]:
        """Return new listeners for bin ``index``; pictures are written into ``folder``."""
        made: list[BinListener] = []
        if self.pictures:
            made.append(Album(folder, f"bin_{index:04d}"))
        if self.video is not None and index == 0:
            made.append(Film(self.video, limit=self.video_limit, speed=self.video_speed))
        if self.recording is not None and index == 0:
            made.append(Recording(self.recording))
        return made
