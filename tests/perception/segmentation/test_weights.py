"""Weights on disk: found by name, read back to the bit, refused when they are not whole."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import trimesh
from safetensors import SafetensorError
from safetensors.torch import save_file

from perception.geometry import make_transform, rotation_about
from perception.part import PartModel
from perception.segmentation import weights as module
from perception.segmentation.networks.context_net import ContextNet, ContextNetConfig
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig
from perception.segmentation.weights import (
    FORMAT,
    GENERAL,
    SHARED,
    SHIPPED,
    FoundWeights,
    Network,
    WeightsError,
    build_network,
    find_weights,
    general_weights,
    install_weights,
    load_network,
    load_record,
    network_name,
    record_of_initial,
    save_network,
    training_of,
    weights_name,
)
from perception.shape import shape_signature

NETWORKS = [
    GridNet(GridNetConfig(widths=(4, 5, 6, 7, 8), hidden=9, embedding=3)),
    Sgpn(SgpnConfig(trunk="dgcnn", k=4, global_width=8, embedding=5, branch=6)),
    ContextNet(ContextNetConfig(k=4, edge_k=3, edge=5, widths=(6, 7, 8), depths=(1, 1, 1), branch=9, embedding=4)),
]


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Return the user's folder and the shipped one, both empty."""
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "SHIPPED", tmp_path / "shipped")
    return tmp_path / "cache" / "weights", tmp_path / "shipped"


@pytest.fixture
def double_by_default() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.parametrize("config", [network.config for network in NETWORKS], ids=["grid", "sgpn", "context"])
def test_networks_are_of_single_precision_whatever_the_callers_default(
    config: GridNetConfig | SgpnConfig, double_by_default: None
) -> None:
    network = build_network(config)
    assert {tensor.dtype for tensor in network.state_dict().values() if tensor.is_floating_point()} == {torch.float32}


@pytest.mark.parametrize("network", NETWORKS, ids=["grid", "sgpn", "context"])
def test_networks_of_files_are_of_single_precision_whatever_the_callers_default(
    network: GridNet | Sgpn, tmp_path: Path, double_by_default: None
) -> None:
    save_network(tmp_path / "tee.safetensors", network, {})
    loaded = load_network(tmp_path / "tee.safetensors")
    assert {tensor.dtype for tensor in loaded.state_dict().values() if tensor.is_floating_point()} == {torch.float32}


@pytest.mark.parametrize("network", NETWORKS, ids=["grid", "sgpn", "context"])
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
            r"\(the network that it describes needs a tensor of \(1, 10\) for confidence",
        ),
        ({"kind": "oracle"}, "its network must be one of grid, sgpn, context, got 'oracle'"),
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


def box(name: str, *sides: float) -> PartModel:
    return PartModel.from_mesh(name, trimesh.creation.box(sides))


NUT, BOLT = box("nut", 0.03, 0.03, 0.01), box("bolt", 0.01, 0.01, 0.06)


def trained(*parts: PartModel, **others: object) -> dict[str, object]:
    """Return the record of a training on parts."""
    return {"parts": [p.name for p in parts], "shapes": {p.name: shape_signature(p) for p in parts}, **others}


def test_the_users_own_go_before_shipped_ones_and_a_parts_own_before_those_for_several(
    folders: tuple[Path, Path],
) -> None:
    own, shipped = folders
    with pytest.raises(WeightsError, match="no segmentation weights for 'nut' and none for every part"):
        find_weights(NUT)
    for folder, name, parts in (
        (shipped, "shared", (NUT, BOLT)),
        (shipped, "nut", (NUT,)),
        (own, "shared", (NUT, BOLT)),
    ):
        save_network(folder / f"{name}.safetensors", NETWORKS[0], trained(*parts))
        expected = shipped / "nut.safetensors" if folder == own else folder / f"{name}.safetensors"
        assert find_weights(NUT) == FoundWeights(path=expected, training="own")
    assert find_weights(BOLT).path == own / "shared.safetensors"
    assert install_weights(shipped / "nut.safetensors", "nut") == own / "nut.safetensors"
    assert find_weights(NUT).path == own / "nut.safetensors"
    assert load_network(own / "nut.safetensors").config == NETWORKS[0].config


def test_a_part_is_recognised_by_its_shape_whatever_its_name_and_file(folders: tuple[Path, Path]) -> None:
    own, shipped = folders
    save_network(shipped / "shared.safetensors", NETWORKS[0], trained(BOLT))
    save_network(own / "nut.safetensors", NETWORKS[0], trained(NUT))
    fine = trimesh.creation.box((0.03, 0.03, 0.01)).subdivide()
    fine.apply_transform(make_transform(rotation_about((1, 2, 3), 0.4), (0.1, 0.0, 0.2)))
    assert find_weights(PartModel.from_mesh("my_part", fine)) == FoundWeights(
        path=own / "nut.safetensors", training="own"
    )
    other = find_weights(box("nut", 0.03, 0.03, 0.012))  # another part of that name
    assert other == FoundWeights(path=shipped / "shared.safetensors", training="zero-shot")


def test_weights_for_every_part_serve_those_without_their_own(folders: tuple[Path, Path]) -> None:
    own, shipped = folders
    save_network(shipped / "shared.safetensors", NETWORKS[0], trained(BOLT))
    start = trained(box("lid", 0.05, 0.05, 0.004))
    save_network(shipped / "general.safetensors", NETWORKS[0], {"general": True, "initial": start, "shapes": {}})
    assert find_weights(BOLT) == FoundWeights(path=shipped / "shared.safetensors", training="own")
    assert find_weights(NUT) == FoundWeights(path=shipped / "general.safetensors", training="zero-shot")
    assert find_weights(box("cover", 0.05, 0.05, 0.004)).training == "own"  # the training started from that one
    save_network(own / "general.safetensors", NETWORKS[0], {"general": True, "families": ["generated:clevis"]})
    assert find_weights(box("generated:clevis:3:50-110", 0.03, 0.02, 0.01)).training == "family"
    assert find_weights(NUT).path == own / "general.safetensors"


def test_records_without_shapes_are_matched_by_name_and_damaged_files_are_left_out(
    folders: tuple[Path, Path], caplog: pytest.LogCaptureFixture
) -> None:
    own, _ = folders
    save_network(own / "old.safetensors", NETWORKS[0], {"parts": ["nut"]})
    (own / "bad.safetensors").write_bytes(b"nothing")
    assert find_weights(NUT) == FoundWeights(path=own / "old.safetensors", training="own")
    assert "left out" in caplog.text
    assert "bad.safetensors does not hold a complete segmentation network" in caplog.text


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


def test_weights_for_every_part_are_shipped_and_name_the_families_that_no_training_saw() -> None:
    path = SHIPPED / f"{GENERAL}.safetensors"
    record = load_record(path)
    lineage = [record, record["initial"], record["initial"]["initial"]]
    assert not set(record["held_out_families"]) & {family for each in lineage for family in each.get("families", [])}
    assert len(record["held_out_families"]) == 9
    assert [training_of(record, box(f"{family}:0", 0.02, 0.03, 0.04)) for family in record["held_out_families"]] == (
        ["zero-shot"] * 9
    )
    assert training_of(record, box("generated:hex_bolt:99", 0.02, 0.03, 0.04)) == "family"
    assert json.loads(path.with_suffix(".json").read_text()) == record
    assert load_network(path).config == replace(GridNetConfig(), shape=True)


def test_weights_over_points_for_every_part_are_shipped() -> None:
    path = SHIPPED / f"{weights_name(GENERAL, 'dgcnn-context')}.safetensors"
    record = load_record(path)
    assert network_name(record) == "dgcnn-context"
    assert record["general"]
    assert training_of(record, box(f"{record['held_out_families'][0]}:0", 0.02, 0.03, 0.04)) == "zero-shot"
    assert json.loads(path.with_suffix(".json").read_text()) == record
    assert load_network(path).config == ContextNetConfig()


def test_a_training_on_one_part_starts_from_the_network_for_every_part(folders: tuple[Path, Path]) -> None:
    own, shipped = folders
    with pytest.raises(WeightsError, match=r"for every part, neither in .* --part generated makes them$"):
        general_weights()
    save_network(own / "nut.safetensors", NETWORKS[0], trained(NUT))
    save_network(shipped / "shared.safetensors", NETWORKS[0], trained(BOLT))
    assert general_weights() == shipped / "shared.safetensors"
    save_network(shipped / "general.safetensors", NETWORKS[0], {"general": True, "shapes": {}})
    assert general_weights() == shipped / "general.safetensors"
    save_network(own / "general.safetensors", NETWORKS[0], {"general": True, "shapes": {}})
    assert general_weights() == own / "general.safetensors"


def test_a_record_does_not_grow_with_the_number_of_trainings_and_forgets_no_part() -> None:
    first = trained(box("lid", 0.05, 0.05, 0.004), families=["generated:clevis"], steps=0, command="train")
    record, sizes = first | {"log": []}, []
    for step in range(1, 60):
        record = trained((NUT, BOLT)[step % 2], steps=step, command="train", initial=record_of_initial(record))
        sizes.append(len(json.dumps(record)))
    assert sizes[20] == sizes[-1] or max(sizes[20:]) - min(sizes[20:]) < 20  # numbers of more digits
    assert record["initial"]["command"] == "train"
    assert "command" not in record["initial"]["initial"]
    assert [training_of(record, part) for part in (NUT, BOLT, box("cover", 0.05, 0.05, 0.004))] == ["own"] * 3
    assert training_of(record, box("generated:clevis:1", 0.02, 0.02, 0.03)) == "family"
    assert training_of(record, box("washer", 0.02, 0.02, 0.002)) == "zero-shot"


def test_parts_of_records_without_shapes_are_kept_by_name() -> None:
    record: dict[str, object] = {"parts": ["nut"]}
    for step in range(10):
        record = {"parts": ["bolt"], "steps": step, "initial": record_of_initial(record)}
    assert (training_of(record, NUT), training_of(record, BOLT)) == ("own", "own")


def test_each_kind_of_network_has_weights_of_its_own(folders: tuple[Path, Path]) -> None:
    _, shipped = folders
    part = PartModel.from_mesh("rod", trimesh.creation.box((0.1, 0.01, 0.01)))
    kinds = ("grid", "dgcnn-sgpn", "dgcnn-context")
    for network, kind in zip(NETWORKS, kinds, strict=True):
        save_network(shipped / f"{weights_name(GENERAL, kind)}.safetensors", network, {"parts": [], "general": True})
    assert sorted(path.stem for path in shipped.glob("*.safetensors")) == [
        "general",
        "general-dgcnn-context",
        "general-dgcnn-sgpn",
    ]
    for kind in kinds:
        found = find_weights(part, kind).path
        assert found == general_weights(kind)
        assert network_name(load_record(found)) == kind
    assert find_weights(part).path == find_weights(part, "grid").path
    save_network(shipped / "rod-dgcnn-sgpn.safetensors", NETWORKS[1], {"parts": ["rod"]})
    assert find_weights(part, "dgcnn-sgpn").training == "own"
    assert find_weights(part, "dgcnn-context").training == "zero-shot"


def test_a_kind_without_weights_is_named(folders: tuple[Path, Path]) -> None:
    _, shipped = folders
    part = PartModel.from_mesh("rod", trimesh.creation.box((0.1, 0.01, 0.01)))
    save_network(shipped / "general.safetensors", NETWORKS[0], {"parts": [], "general": True})
    with pytest.raises(
        WeightsError, match=r"no segmentation weights of the network dgcnn-sgpn for .rod. .* --preset dg"
    ):
        find_weights(part, "dgcnn-sgpn")
    with pytest.raises(WeightsError, match="no segmentation weights of the network dgcnn-context for every part"):
        general_weights("dgcnn-context")
    with pytest.raises(ValueError, match="network must be one of grid, dgcnn-sgpn, dgcnn-context, got 'unet'"):
        find_weights(part, "unet")


def test_a_network_that_nothing_looks_for_is_not_installed(folders: tuple[Path, Path], tmp_path: Path) -> None:
    own, _ = folders
    save_network(own / "nut.safetensors", NETWORKS[0], trained(NUT))
    pointnet = SgpnConfig(trunk="pointnet", global_width=8, embedding=5, branch=6)
    save_network(tmp_path / "net.safetensors", Sgpn(pointnet), trained(NUT))
    assert network_name(load_record(tmp_path / "net.safetensors")) is None
    with pytest.raises(WeightsError, match=r"net.safetensors cannot be installed, since no command looks for its net"):
        install_weights(tmp_path / "net.safetensors", "nut")
    assert find_weights(NUT).path == own / "nut.safetensors"


@pytest.mark.parametrize("network", NETWORKS[1:])
def test_every_kind_is_installed_beside_the_others(
    folders: tuple[Path, Path], tmp_path: Path, network: Network
) -> None:
    own, _ = folders
    save_network(own / "shared.safetensors", NETWORKS[0], trained(NUT, BOLT))
    save_network(tmp_path / "net.safetensors", network, trained(NUT, BOLT))
    kind = network_name(load_record(tmp_path / "net.safetensors"))
    assert kind is not None
    assert install_weights(tmp_path / "net.safetensors", SHARED) == own / f"shared-{kind}.safetensors"
    assert find_weights(NUT).path == own / "shared.safetensors"
    assert find_weights(NUT, kind).path == general_weights(kind) == own / f"shared-{kind}.safetensors"


@pytest.mark.parametrize("network", NETWORKS[1:])
def test_weights_that_were_installed_without_their_kind_are_found(folders: tuple[Path, Path], network: Network) -> None:
    own, _ = folders
    save_network(own / "shared.safetensors", network, trained(BOLT))
    kind = network_name(load_record(own / "shared.safetensors"))
    assert kind is not None
    assert general_weights(kind) == own / "shared.safetensors"
    assert find_weights(BOLT, kind) == FoundWeights(path=own / "shared.safetensors", training="own")
    assert find_weights(NUT, kind) == FoundWeights(path=own / "shared.safetensors", training="zero-shot")


def test_a_parts_own_weights_of_another_kind_are_named(
    folders: tuple[Path, Path], caplog: pytest.LogCaptureFixture
) -> None:
    own, shipped = folders
    save_network(shipped / "shared.safetensors", NETWORKS[0], trained(NUT, BOLT))
    save_network(shipped / "general-dgcnn-sgpn.safetensors", NETWORKS[1], {"general": True, "shapes": {}})
    save_network(own / "nut.safetensors", NETWORKS[2], trained(NUT))
    assert find_weights(NUT).path == shipped / "shared.safetensors"
    assert [record.getMessage() for record in caplog.records] == [
        f"{own / 'nut.safetensors'} was trained on nut, but not for the network grid: it is used with --network "
        "dgcnn-context"
    ]
    caplog.clear()
    find_weights(NUT, "dgcnn-context")
    find_weights(BOLT, "dgcnn-sgpn")  # only a shipped network of another kind was trained on it
    assert caplog.text == ""
    save_network(own / "bolt.safetensors", NETWORKS[0], trained(BOLT))
    find_weights(BOLT, "dgcnn-sgpn")
    assert "but not for the network dgcnn-sgpn: it is used with --network grid, which needs frames with" in caplog.text
