from io import StringIO

import pytest

from binpick_env.jobs import ray_cluster
from policies.commands.progress import ProgressBar


@pytest.mark.parametrize(
    ("nodes", "shown"), [(0, "it/s, last=2]"), (1, "last=2, on 1 node]"), (3, "last=2, on 3 nodes]")]
)
def test_a_bar_names_the_nodes_of_a_cluster(nodes: int, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_cluster, "_nodes", nodes)
    drawn = StringIO()
    with ProgressBar(total=4, file=drawn, ncols=100, unit="it") as bar:
        bar.update(2)
        bar.set_postfix(last=2)
        assert str(bar).endswith(shown)
    assert ("node" in drawn.getvalue()) == (nodes > 0)
