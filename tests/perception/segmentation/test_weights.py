"""Weights on disk: found by name, read back to the bit, refused when they are not whole."""

import json
from pathlib import Path

import pytest
import torch
from safetensors import SafetensorError
from safetensors.torch import save_file

from perception.segmentation import weights as module
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig
from perception.segmentation.weights import (
    FORMAT,
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


def test_half_the_bits_are_nearly_the_same_network(tmp_path: Path) -> None:
    paths = [tmp_path / "whole.safetensors", tmp_path / "half.safetensors"]
    network = GridNet(GridNetConfig())
    for path, half in zip(paths, (False, True), strict=True):
        save_network(path, network, {}, half=half)
    assert paths[1].stat().st_size < 0.51 * paths[0].stat().st_size
    back = load_network(paths[1])
    for name, value in network.state_dict().items():
        assert back.state_dict()[name].dtype == value.dtype
        torch.testing.assert_close(back.state_dict()[name], value, rtol=1e-3, atol=1e-6)


def test_what_is_not_whole_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tee.safetensors"
    with pytest.raises(WeightsError, match=r"tee\.safetensors does not hold a complete segmentation network"):
        load_network(path)
    save_network(path, NETWORKS[0], {})
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(WeightsError, match="does not hold a complete segmentation network"):
        load_network(path)
    record = json.loads(path.with_suffix(".json").read_text())
    for change, text in (
        (
            {"network": record["network"] | {"hidden": 10}},
            r"a complete segmentation network \(Error\(s\) in loading",
        ),
        ({"kind": "oracle"}, "its network must be one of grid, sgpn, got 'oracle'"),
        ({"version": 99}, "is a segmentation network of version 99, this code reads 1"),
    ):
        FORMAT.save_tensors(path, NETWORKS[0].state_dict(), record | change)
        with pytest.raises(WeightsError, match=text):
            load_network(path)
    save_file(NETWORKS[0].state_dict(), path)
    with pytest.raises(WeightsError, match=r"does not hold a complete segmentation network \(it has no header\)"):
        load_network(path)


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "tee.safetensors"
    save_network(path, NETWORKS[0], {"steps": 1})

    def full(*_: object, **__: object) -> None:
        raise SafetensorError("No space left on device")

    monkeypatch.setattr("safetensors.torch.save_file", full)
    with pytest.raises(OSError, match=r"tee\.safetensors cannot be written \(No space left on device\)"):
        save_network(path, NETWORKS[0], {"steps": 2})
    assert load_record(path)["steps"] == 1
    assert len(list(tmp_path.iterdir())) == 2


def test_the_record_travels_with_the_weights(tmp_path: Path) -> None:
    path = tmp_path / "tee.safetensors"
    save_network(path, NETWORKS[0], {"steps": 7})
    assert json.loads(path.with_suffix(".json").read_text()) == load_record(path)
    path.with_suffix(".json").unlink()
    assert load_record(path)["steps"] == 7
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
    path = next((path for path in paths if path.exists()), None)
    assert path is not None
    record = load_record(path)
    assert part in record["parts"]
    assert part in [source["part"] for source in record["trained_on"]]
    assert {"training", "steps", "minutes", "scenes", "validation", "git_commit"} <= record.keys()
    assert json.loads(path.with_suffix(".json").read_text()) == record
    load_network(path)
