"""Weights on disk: found by name, read back to the bit, refused when they are not whole."""

import json
from pathlib import Path

import pytest
import torch

from perception.segmentation import weights as module
from perception.segmentation.grid_net import GridNet, GridNetConfig
from perception.segmentation.sgpn import Sgpn, SgpnConfig
from perception.segmentation.weights import (
    SHARED,
    SHIPPED,
    WeightsError,
    find_weights,
    install_weights,
    load_network,
    load_record,
    save_network,
)

NETWORKS = [
    GridNet(GridNetConfig(widths=(4, 5, 6, 7, 8), hidden=9, embedding=3)),
    Sgpn(SgpnConfig(trunk="dgcnn", k=4, global_width=8, embedding=5, branch=6)),
]


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Return the user's folder and the shipped one, both empty."""
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "SHIPPED", tmp_path / "shipped")
    return tmp_path / "cache" / "weights", tmp_path / "shipped"


@pytest.mark.parametrize("network", NETWORKS, ids=["grid", "sgpn"])
def test_a_network_comes_back_to_the_bit(network: GridNet | Sgpn, tmp_path: Path) -> None:
    path = tmp_path / "tee.safetensors"
    save_network(path, network, {"parts": ["tee"], "steps": 7})
    back = load_network(path)
    assert back.config == network.config
    assert not back.training
    assert all(torch.equal(value, back.state_dict()[name]) for name, value in network.state_dict().items())
    assert load_record(path)["steps"] == 7
    assert sorted(p.name for p in tmp_path.iterdir()) == ["tee.json", "tee.safetensors"]


def test_what_is_not_whole_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tee.safetensors"
    with pytest.raises(WeightsError, match=r"tee\.json does not describe a network"):
        load_network(path)
    save_network(path, NETWORKS[0], {})
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(WeightsError, match="does not hold the network that its JSON describes"):
        load_network(path)
    save_network(path, NETWORKS[0], {})
    note = path.with_suffix(".json")
    record = json.loads(note.read_text())
    note.write_text(json.dumps(record | {"network": record["network"] | {"hidden": 10}}))
    with pytest.raises(WeightsError, match="does not hold the network that its JSON describes"):
        load_network(path)
    note.write_text(json.dumps(record | {"version": 99}))
    with pytest.raises(WeightsError, match="is of version 99, this code reads 1"):
        load_network(path)


def test_the_users_own_go_before_shipped_ones_and_a_parts_own_before_shared_ones(folders: tuple[Path, Path]) -> None:
    own, shipped = folders
    with pytest.raises(WeightsError, match=r"no segmentation weights for 'tee': train them with .*--part tee"):
        find_weights("tee")
    save_network(shipped / f"{SHARED}.safetensors", NETWORKS[0], {"parts": ["tee", "bracket"]})
    assert find_weights("tee") == shipped / f"{SHARED}.safetensors"
    with pytest.raises(WeightsError, match="no segmentation weights for 'nut'"):
        find_weights("nut")
    save_network(shipped / "tee.safetensors", NETWORKS[0], {})
    assert find_weights("tee") == shipped / "tee.safetensors"
    assert install_weights(shipped / "tee.safetensors", "tee") == own / "tee.safetensors"
    assert find_weights("tee") == own / "tee.safetensors"
    assert load_network(own / "tee.safetensors").config == NETWORKS[0].config


def test_shared_weights_of_the_users_own_are_found_too(folders: tuple[Path, Path]) -> None:
    own, _ = folders
    save_network(own / f"{SHARED}.safetensors", NETWORKS[0], {"parts": ["nut"]})
    assert find_weights("nut") == own / f"{SHARED}.safetensors"


@pytest.mark.parametrize("part", ["part_a", "part_b", "part_c", "tee", "bracket"])
def test_weights_for_the_catalogue_are_shipped(part: str) -> None:
    paths = (SHIPPED / f"{part}.safetensors", SHIPPED / f"{SHARED}.safetensors")
    path = next(path for path in paths if path.exists())
    record = load_record(path)
    assert part in record["parts"]
    assert {"training", "steps", "scenes", "validation", "git_commit"} <= record.keys()
    load_network(path)
