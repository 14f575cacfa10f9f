"""Progress bars, which show the nodes of a cluster beside rate and remaining time."""

from collections.abc import MutableMapping
from typing import Any

from tqdm import tqdm

from binpick_env.jobs.ray_cluster import nodes_in_use
from binpick_env.jobs.text_tables import counted


class ProgressBar(tqdm):  # type: ignore[type-arg]
    """A bar that names the number of nodes while a cluster computes."""

    @property
    def format_dict(self) -> MutableMapping[str, Any]:
        """Facts that the bar is drawn from."""
        facts = super().format_dict
        if nodes := nodes_in_use():
            text = f"on {counted(nodes, 'node')}"
            facts["postfix"] = f"{facts['postfix']}, {text}" if facts["postfix"] else text
        return facts
