from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from binpick_env.config import CONTROL_PERIOD
from policies.report.media import BinMedia
from policies.report.video import EVERY, SPEED, Film, check_video

pytest.importorskip("imageio_ffmpeg")


class Stage:
    """Renders a moving square."""

    def __init__(self) -> None:
        self.shots = 0

    def render(self) -> Any:
        picture = np.zeros((49, 65, 3), np.uint8)
        picture[10:20, self.shots : self.shots + 10] = 255
        self.shots += 1
        return picture


def shoot(film: Film, steps: int) -> Stage:
    stage = Stage()
    for _ in range(steps):
        film.after_step(stage)  # type: ignore[arg-type]
    return stage


def test_a_film_shows_every_nth_step(tmp_path: Path) -> None:
    path = tmp_path / "new" / "film.mp4"
    with Film(path) as film:
        stage = shoot(film, 5 * EVERY)
        assert not path.exists()  # it appears when it is whole
    assert stage.shots == 5
    reader = cv2.VideoCapture(str(path))
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(SPEED / (EVERY * CONTROL_PERIOD))
    shots = []
    while (shot := reader.read())[0]:
        shots.append(shot[1])
    reader.release()
    assert [shot.shape for shot in shots] == [(48, 64, 3)] * 5
    assert [p.name for p in path.parent.iterdir()] == ["film.mp4"]


def test_a_film_ends_at_its_limit(tmp_path: Path) -> None:
    with Film(tmp_path / "film.mp4", limit=0.4) as film:
        assert shoot(film, 100).shots == 3  # steps 0, 4 and 8 of ten


def test_the_speed_of_a_film_is_its_rate_of_pictures(tmp_path: Path) -> None:
    with Film(tmp_path / "film.mp4", speed=1.0) as film:
        shoot(film, 2 * EVERY)
    reader = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(1 / (EVERY * CONTROL_PERIOD))
    reader.release()


def test_a_crash_leaves_no_half_film(tmp_path: Path) -> None:
    film = Film(tmp_path / "film.mp4")
    shoot(film, EVERY)
    film.__exit__(FloatingPointError, FloatingPointError(), None)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_filmed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"must end in \.mp4, got 'film\.avi'"):
        check_video(Path("film.avi"))
    with pytest.raises(ValueError, match=r"must end in \.mp4"):
        Film(tmp_path / "film.avi")

    with pytest.raises(ValueError, match=r"speed must be from 0\.25 to 20 times the real one, got 0"):
        check_video(Path("film.mp4"), speed=0.0)
    with pytest.raises(ValueError, match=r"limit must be positive, got -1 s of simulated time"):
        check_video(Path("film.mp4"), limit=-1.0)

    with pytest.raises(ValueError, match=r"limit must be positive, got nan s of simulated time"):
        BinMedia(video_limit=float("nan")).check(1)  # without a film, too

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr("policies.report.video.importlib.import_module", missing)
    with pytest.raises(ModuleNotFoundError, match=r"\.venv/bin/python -m pip install -e '\.\[report\]'"):
        check_video(tmp_path / "film.mp4")
