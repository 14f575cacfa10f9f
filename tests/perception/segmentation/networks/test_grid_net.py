"""The image-plane network and what it is shown."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from perception.segmentation.networks.grid import CHANNELS, DETAIL_SCALE, FINE, LOCAL, MULTIPLE, place_in, view_grid
from perception.segmentation.networks.grid_net import (
    GridInputs,
    GridNet,
    GridNetConfig,
    gather_bilinear,
    shape_input,
)
from perception.segmentation.networks.inputs import centred
from tests.perception.disc_scene import disc_scene

SMALL = GridNetConfig(widths=(4, 5, 6, 7, 8), hidden=9, embedding=3)


def inputs(batch: int = 2, height: int = 32, width: int = 48, points: int = 20, seed: int = 0) -> GridInputs:
    torch.manual_seed(seed)
    place = torch.rand(batch, points, 2) * torch.tensor([width, height])
    return GridInputs(
        torch.randn(batch, CHANNELS, height, width),
        place,
        torch.randn(batch, points, LOCAL),
        torch.randn(batch, points, 3),
    )


def test_shapes_and_ranges() -> None:
    said = GridNet(SMALL).eval()(inputs())
    assert said.embedding_BNF.shape == (2, 20, 3 + 3)
    assert said.semantics_BNS.shape == (2, 20, 1)
    assert said.offsets_BN3 is not None
    assert said.offsets_BN3.shape == (2, 20, 3)
    assert ((said.confidence_BN > 0) & (said.confidence_BN < 1)).all()


def test_the_embedding_begins_with_the_scaled_vote() -> None:
    batch = inputs()
    said = GridNet(SMALL).eval()(batch)
    assert said.offsets_BN3 is not None
    torch.testing.assert_close(said.embedding_BNF[..., :3], 50.0 * (batch.points_BN3 + said.offsets_BN3))


def test_a_point_does_not_depend_on_the_others_or_on_their_order() -> None:
    network, batch = GridNet(SMALL).eval(), inputs()
    whole = network(batch)
    order = torch.randperm(20)
    turned = network(batch._replace(place_BN2=batch.place_BN2[:, order], local_BNL=batch.local_BNL[:, order],
                                    points_BN3=batch.points_BN3[:, order]))  # fmt: skip
    torch.testing.assert_close(turned.embedding_BNF, whole.embedding_BNF[:, order])
    alone = network(GridInputs(*(array[:1] for array in batch[:4])))
    torch.testing.assert_close(alone.confidence_BN, whole.confidence_BN[:1])


def test_at_first_the_shape_changes_nothing_and_it_can_be_learned() -> None:
    torch.manual_seed(0)
    without = GridNet(SMALL).eval()
    torch.manual_seed(0)
    network, batch = GridNet(replace(SMALL, shape=True)).eval(), inputs()
    told = batch._replace(shape_BS=torch.from_numpy(np.stack([shape_input(np.ones(5)), shape_input(None)])))
    torch.testing.assert_close(network(told).embedding_BNF, without(batch).embedding_BNF, rtol=0, atol=0)
    for layer in network.shape:
        torch.nn.init.normal_(layer.weight)
        torch.nn.init.normal_(layer.bias)
    known, unknown = network(told), network(batch)
    torch.testing.assert_close(known.embedding_BNF[1], unknown.embedding_BNF[1])
    assert (known.embedding_BNF[0] - unknown.embedding_BNF[0]).abs().max() > 0.1


def test_an_unknown_shape_is_zeros_and_a_known_one_ends_with_1() -> None:
    assert shape_input(None).tolist() == [0.0] * 6
    assert shape_input(np.arange(5.0)).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 1.0]


def test_gathering_is_bilinear_between_cell_middles() -> None:
    height, width = 5, 7
    features = torch.arange(height * width, dtype=torch.float32).view(1, 1, height, width).repeat(2, 3, 1, 1)
    place = torch.tensor([[[0.5, 0.5], [3.0, 2.25], [6.5, 4.5], [0.0, 0.0], [9.0, 9.0]]]).repeat(2, 1, 1)
    found = gather_bilinear(features, place)[1, :, 2]
    torch.testing.assert_close(found, torch.tensor([0.0, 1.75 * 7 + 2.5, 34.0, 0.0, 34.0]))


def test_gathering_is_what_torchs_grid_sample_does() -> None:
    torch.manual_seed(0)
    features, place = torch.randn(2, 3, 6, 9), torch.rand(2, 40, 2) * torch.tensor([9.0, 6.0])
    normed = place / torch.tensor([9.0, 6.0]) * 2 - 1
    wanted = torch.nn.functional.grid_sample(
        features, normed[:, None], mode="bilinear", padding_mode="border", align_corners=False
    )[:, :, 0].mT
    torch.testing.assert_close(gather_bilinear(features, place), wanted, atol=1e-5, rtol=1e-5)


def test_every_weight_is_reached_by_the_gradient() -> None:
    network = GridNet(SMALL)
    said = network(inputs())
    assert said.offsets_BN3 is not None
    total = said.embedding_BNF.square().sum() + said.confidence_BN.sum() + said.semantics_BNS.sum()
    total.backward()
    assert [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0] == []


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"widths": (4, 5)}, "widths must be five positive channel counts"),
        ({"hidden": 0}, "hidden must be at least 1, got 0"),
        ({"embedding": 0}, "embedding must be at least 1"),
        ({"vote_scale": -1.0}, "vote_scale must not be negative, got -1.0"),
    ],
)
def test_nonsense_sizes_are_named(values: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        GridNetConfig(**values)


def test_a_scene_in_cells() -> None:
    scene = disc_scene()
    points = scene.boundary.points_cam
    place = place_in(scene.surface, scene.boundary.pixels)
    view = view_grid(scene.surface.depth, place, points[:, 2], scene.d_max, reference=0.9)
    channels, rows, columns = view.cells.shape
    assert channels == CHANNELS
    assert rows % MULTIPLE == columns % MULTIPLE == 0
    fine = view.cells.reshape(4, FINE, FINE, rows, columns).transpose(0, 3, 1, 4, 2).reshape(4, rows * FINE, -1)
    height, width = scene.surface.depth.shape
    np.testing.assert_allclose(fine[0, :height, :width], (0.9 - scene.surface.depth) / scene.d_max, atol=1e-6)
    np.testing.assert_array_equal(fine[2, :height, :width], 1.0)
    assert fine[2, height:].sum() == fine[0, height:].sum() == 0.0
    counts = np.zeros(fine[3].shape)
    np.add.at(counts, (np.floor(place[:, 1]).astype(int), np.floor(place[:, 0]).astype(int)), 1)
    np.testing.assert_allclose(fine[3], np.minimum(counts, 3) / 3, atol=1e-6)
    np.testing.assert_allclose(view.local[:, 3], (0.9 - points[:, 2]) / scene.d_max, atol=1e-6)
    assert np.abs(view.local[:, :2]).max() <= 0.5


def test_detail_is_what_stands_out_of_its_neighbourhood() -> None:
    surface = np.full((64, 64), 0.9, np.float32)
    surface[32, 32] -= 0.01 * 0.08  # a hundredth of d_max
    place = np.array([[32.5, 32.5]])
    view = view_grid(surface, place, np.array([0.9 - 0.02 * 0.08]), 0.08, reference=0.9)
    detail = view.cells.reshape(4, 2, 2, 32, 32)[1, :, :, 16, 16]
    assert detail[0, 0] == pytest.approx(0.01 / DETAIL_SCALE * (1 - 1 / 81), rel=1e-2)
    assert view.local[0, 2] == pytest.approx(0.01 / DETAIL_SCALE, rel=1e-2)


def test_points_are_centred_in_multiples_of_a_length() -> None:
    points = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 5.0]])
    np.testing.assert_allclose(centred(points, 2.0), [[-0.5, 0, -0.5], [0.5, 0, 0.5]])
