"""Where a page takes its pictures from: itself, as data URIs, or files beside it once it would grow too large."""

import base64
import os
from pathlib import Path
from urllib.parse import quote

INLINE_LIMIT = 13_000_000  # total size of the pictures inside a page [bytes]; the page has 18 MB then, to be mailed
_KINDS = {".jpg": "jpeg", ".webp": "webp", ".png": "png"}


class PictureSource:
    """Sources of a page's pictures.

    A decision's picture has some 28 kB in a bin of 25 parts: 17 bins, about 460 decisions, are all inside. Of 20 bins,
    whose pictures have 15 MB, the last 80 deliveries are linked. Pictures get their place in the order in which they
    are asked for.

    Attributes:
        linked: Names of the pictures that are linked and not inside.
    """

    def __init__(self, folder: Path, page: Path, limit: int = INLINE_LIMIT) -> None:
        """Read nothing yet.

        Args:
            folder: Folder of the pictures.
            page: Path of the HTML file.
            limit: Largest total size of the pictures inside the page [bytes].
        """
        self._folder, self._limit = folder, limit
        self._relative = Path(os.path.relpath(folder, page.parent)).as_posix()
        self.linked: list[str] = []

    def source(self, name: str) -> str | None:
        """Return the ``src`` of a picture by its file name; None if there is no such file."""
        path = self._folder / name
        if not name or not path.is_file():
            return None
        size = path.stat().st_size
        if size > self._limit:
            self.linked.append(name)
            return quote(f"{self._relative}/{name}")
        self._limit -= size
        return f"data:image/{_KINDS[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"
