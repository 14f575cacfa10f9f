"""What the library logs, as lines on stderr above a progress bar."""

import logging
import sys


class StatusHandler(logging.Handler):
    """Prints status lines as they are, and warnings with their level, without breaking a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        from tqdm import tqdm

        level = f"{record.levelname} " if record.levelno > logging.INFO else ""
        tqdm.write(level + record.getMessage(), file=sys.stderr)


def show_status() -> None:
    """Print what the packages log at level INFO, such as what takes seconds at the start, and every warning."""
    logging.basicConfig(level=logging.WARNING, handlers=[StatusHandler()])
    for name in ("perception", "binpick_env", "policies"):
        logging.getLogger(name).setLevel(logging.INFO)
