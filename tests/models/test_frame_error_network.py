import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, MapWindow
from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2
from rendezvous.models import lie
from rendezvous.models.frame_error_network import (
    FrameErrorConfig,
    FrameErrorNet,
    FrameErrorViT,
    attention_rollout,
    build_frame_error,
    input_grid,
    output_pose,
)
from rendezvous.models.losses import frame_error_loss
from tests.models.worlds import batch

SMALL = {
    vit: FrameErrorConfig(vit=vit, cells=48, cell_m=0.4, width=64, depth=3, heads=4) for vit in (True, False)
}
both_networks = pytest.mark.parametrize("vit", [True, False], ids=["vit", "cnn"])


def built(config: FrameErrorConfig, seed: int = 0) -> FrameErrorNet:
    return build_frame_error(config, generator=torch.Generator().manual_seed(seed))


def random_grid(count: int = 3, *, cells: int = 48, seed: int = 1) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(-1, 2, (count, 2, cells, cells), generator=generator).float()


def test_the_input_codes_what_the_pooled_window_holds() -> None:
    cells = np.random.default_rng(0).choice(3, (2, 24, 24), p=[0.6, 0.3, 0.1]).astype(np.uint8)
    pooled = MapWindow(cells=cells, cell_m=0.05).pooled(2).cells
    expected = np.array([0.0, -1.0, 1.0])[pooled]
    assert np.unique(expected).tolist() == [-1.0, 0.0, 1.0]
    grid_12HW = input_grid(torch.from_numpy(cells)[None], cells=12)
    assert grid_12HW.dtype == torch.float32
    np.testing.assert_array_equal(grid_12HW[0], expected)


def test_a_wall_one_cell_thick_survives_pooling() -> None:
    cells = torch.full((1, 2, 48, 48), FREE_CELL, dtype=torch.uint8)
    cells[0, 1, 21, :] = OCCUPIED_CELL
    grid_12HW = input_grid(cells, cells=12)
    assert (grid_12HW[0, 1, 5] == 1.0).all()
    assert (grid_12HW == 1.0).sum() == 12


def test_a_twist_and_a_pose_are_read_as_they_were_meant() -> None:
    theta = SE2(1.2, -0.4, 0.7)
    pose_13 = torch.tensor([[1.2, -0.4, 0.7]], dtype=torch.float64)
    torch.testing.assert_close(output_pose(lie.log(pose_13), lie_algebra=True), pose_13)
    torch.testing.assert_close(output_pose(pose_13, lie_algebra=False), pose_13)
    beyond_13 = torch.tensor([[0.0, 0.0, 4.0]], dtype=torch.float64)
    for lie_algebra in (True, False):
        yaw_rad = output_pose(beyond_13, lie_algebra=lie_algebra)[0, 2].item()
        assert yaw_rad == pytest.approx(SE2(0.0, 0.0, 4.0).wrapped().yaw_rad)
    assert theta.as_array().tolist() == pose_13[0].tolist()


@both_networks
def test_any_batch_gives_three_numbers_a_sample(vit: bool) -> None:
    network = built(FrameErrorConfig(vit=vit))
    with torch.no_grad():
        xi_B3 = network(random_grid(2, cells=192))
    assert xi_B3.shape == (2, 3)
    assert xi_B3.dtype == torch.float32


def test_the_twins_have_about_as_many_weights() -> None:
    count = {
        vit: sum(weight.numel() for weight in built(FrameErrorConfig(vit=vit)).parameters())
        for vit in (True, False)
    }
    assert count[True] > 4e6
    assert 0.8 < count[True] / count[False] < 1.25


@both_networks
def test_the_answer_for_a_pair_does_not_depend_on_its_batch(vit: bool) -> None:
    network, grid_B2HW = built(SMALL[vit]), random_grid(5)
    torch.testing.assert_close(network(grid_B2HW)[2:3], network(grid_B2HW[2:3]), atol=1e-6, rtol=1e-4)


@both_networks
def test_the_answer_depends_on_which_map_is_which(vit: bool) -> None:
    network, grid_B2HW = built(SMALL[vit]), random_grid(1)
    assert (network(grid_B2HW) - network(grid_B2HW.flip(1))).abs().max() > 1e-5


@both_networks
def test_every_weight_gets_a_gradient(vit: bool) -> None:
    network = built(SMALL[vit])
    network(random_grid()).square().sum().backward()
    without = [
        name for name, weight in network.named_parameters() if weight.grad is None or not weight.grad.any()
    ]
    assert without == []


@both_networks
def test_half_precision_trains_and_answers_in_single(vit: bool) -> None:
    network, grid_B2HW = built(SMALL[vit]), random_grid()
    single_B3 = network(grid_B2HW)
    with torch.autocast("cpu", torch.bfloat16):
        half_B3 = network(grid_B2HW)
    half_B3.square().sum().backward()
    assert half_B3.dtype == torch.float32
    assert not torch.equal(half_B3, single_B3)
    torch.testing.assert_close(
        half_B3, single_B3, atol=0.05 * float(single_B3.detach().abs().max()), rtol=0.0
    )
    assert all(
        torch.isfinite(weight.grad).all() for weight in network.parameters() if weight.grad is not None
    )


def test_the_answer_is_no_coarser_than_single_precision_under_autocast() -> None:
    network = built(SMALL[False])
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        xi_B3 = network(random_grid(8))
    assert (xi_B3 != xi_B3.bfloat16().float()).float().mean() > 0.9


@pytest.mark.parametrize("half", [True, False], ids=["bfloat16", "float32"])
@pytest.mark.parametrize("grad", [True, False])
def test_fused_attention_gives_what_the_attention_matrices_give(half: bool, grad: bool) -> None:
    network, grid_B2HW = built(SMALL[True]), random_grid()
    assert isinstance(network, FrameErrorViT)
    with torch.set_grad_enabled(grad), torch.autocast("cpu", torch.bfloat16, enabled=half):
        fused_B3 = network(grid_B2HW)
        explicit_B3, attention_BLhTT = network.with_attention(grid_B2HW)
    scale = float(explicit_B3.detach().abs().max())
    torch.testing.assert_close(fused_B3, explicit_B3, atol=scale * (0.05 if half else 1e-5), rtol=0.0)
    assert attention_BLhTT.shape == (3, 3, 4, 145, 145)
    torch.testing.assert_close(attention_BLhTT.float().sum(-1), torch.ones(3, 3, 4, 145), atol=1e-2, rtol=0.0)


@both_networks
def test_the_same_seed_gives_the_same_weights_and_no_other_generator_is_drawn_from(vit: bool) -> None:
    state = torch.get_rng_state()
    first, again, other = (built(SMALL[vit], seed).state_dict() for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert all(torch.isfinite(weights).all() for weights in first.values())
    drawn = [name for name, weights in first.items() if weights.unique().numel() > 1]
    assert drawn
    assert not any(torch.equal(first[name], other[name]) for name in drawn)


def test_a_config_comes_back_from_json() -> None:
    config = FrameErrorConfig(vit=False, lie=False, cells=96, cell_m=0.2, width=128, depth=9, heads=2)
    assert FrameErrorConfig.from_dict(json.loads(json.dumps(config.as_dict()))) == config


@pytest.mark.parametrize("change", [{"layers": 6}, {"vit": None}, {"width": "256"}, {"lie": 1}])
def test_a_config_of_other_fields_is_refused(change: dict[str, object]) -> None:
    values = FrameErrorConfig(vit=True).as_dict() | change
    with pytest.raises(ConfigError, match=f"FrameErrorConfig: {next(iter(change))} is .*; must be"):
        FrameErrorConfig.from_dict(values)


def test_a_config_without_a_field_is_refused() -> None:
    values = FrameErrorConfig(vit=True).as_dict()
    del values["lie"]
    with pytest.raises(ConfigError, match=r"FrameErrorConfig: lie is absent; must be like True"):
        FrameErrorConfig.from_dict(values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cells": 100}, "cells is 100; must be 12 times"),
        ({"cells": 36}, "cells is 36; must be 12 times"),
        ({"cells": 12}, "cells is 12; must be 12 times"),
        ({"heads": 7}, "width is 256; must be a multiple of 7 heads"),
        ({"width": 72}, "width is 72; must be a multiple of 8 heads and of 64"),
        ({"depth": 0}, "depth is 0; must be from 1 to 1024"),
        ({"heads": 0}, "heads is 0; must be from 1 to 1024"),
        ({"width": 0}, "width is 0; must be from 8 to 65536"),
        ({"cell_m": 0.0}, "cell_m is 0.0; must be from 0.001 to 1000"),
    ],
)
def test_a_network_that_cannot_be_built_is_refused(change: dict[str, int], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(FrameErrorConfig(vit=True), **change)


@both_networks
def test_a_network_learns_four_windows_by_heart(vit: bool) -> None:
    cells_B2NN, theta_B3 = batch(4, cells=24, cell_m=0.8)
    config = FrameErrorConfig(vit=vit, cells=24, cell_m=0.8, width=128, depth=2, heads=4)
    grid_B2HW, network = input_grid(cells_B2NN, cells=24), built(config)
    optimiser = torch.optim.AdamW(network.parameters(), lr=1e-3)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = frame_error_loss(
            network, grid_B2HW, theta_B3, lie_algebra=True, omega=0.0, cell_m=config.cell_m
        )
        loss.total.backward()
        optimiser.step()
        losses.append(loss.total.item())
    assert losses[-1] < 0.2 * losses[0]


PLACES = 12 * 12


def random_attention(*, layers: int = 3, heads: int = 4, batch: int = 2) -> Tensor:
    """(B, L, h, T, T) whose rows sum to 1."""
    generator = torch.Generator().manual_seed(0)
    return torch.rand(batch, layers, heads, 1 + PLACES, 1 + PLACES, generator=generator).softmax(dim=-1)


def test_rollout_is_the_sum_over_all_paths_through_the_layers() -> None:
    attention_BLhTT = random_attention()
    for found, attention_LhTT in zip(
        attention_rollout(attention_BLhTT), attention_BLhTT.numpy(), strict=True
    ):
        share_T = np.eye(1 + PLACES)[0]
        for layer_hTT in attention_LhTT[::-1]:  # from the class token at the end back to the input
            share_T = 0.5 * share_T + 0.5 * share_T @ layer_hTT.mean(axis=0)
        expected = share_T[1:].reshape(12, 12) / share_T[1:].sum()
        np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_looking_everywhere_alike_rolls_out_flat() -> None:
    attention_BLhTT = torch.full((1, 6, 8, 1 + PLACES, 1 + PLACES), 1.0 / (1 + PLACES))
    torch.testing.assert_close(attention_rollout(attention_BLhTT), torch.full((1, 12, 12), 1.0 / PLACES))


def test_a_look_at_one_place_lights_that_place() -> None:
    attention_BLhTT = torch.eye(1 + PLACES).repeat(1, 2, 1, 1, 1)
    row, col = 3, 7
    attention_BLhTT[0, 1, 0, 0] = torch.nn.functional.one_hot(torch.tensor(1 + 12 * row + col), 1 + PLACES)
    expected = torch.zeros(1, 12, 12)
    expected[0, row, col] = 1.0
    torch.testing.assert_close(attention_rollout(attention_BLhTT), expected)


def test_what_a_place_looks_at_is_passed_on_to_the_class_token() -> None:
    attention_BLhTT = torch.eye(1 + PLACES).repeat(1, 2, 1, 1, 1)
    seen, relay = 1 + 12 * 2 + 5, 1 + 12 * 9 + 1
    attention_BLhTT[0, 0, 0, relay] = torch.nn.functional.one_hot(torch.tensor(seen), 1 + PLACES)
    attention_BLhTT[0, 1, 0, 0] = torch.nn.functional.one_hot(torch.tensor(relay), 1 + PLACES)
    expected = torch.zeros(1, PLACES)
    expected[0, [seen - 1, relay - 1]] = 0.5
    torch.testing.assert_close(attention_rollout(attention_BLhTT), expected.reshape(1, 12, 12))


def test_a_transformer_has_a_rollout_for_every_pair() -> None:
    config = FrameErrorConfig(vit=True, cells=48, cell_m=0.4, width=64, depth=2, heads=4)
    network = build_frame_error(config, generator=torch.Generator().manual_seed(0))
    assert isinstance(network, FrameErrorViT)
    with torch.no_grad():
        _, attention_BLhTT = network.with_attention(torch.randn(3, 2, 48, 48))
    rollout_BHW = attention_rollout(attention_BLhTT)
    assert rollout_BHW.shape == (3, 12, 12)
    assert (rollout_BHW > 0.0).all()
    torch.testing.assert_close(rollout_BHW.sum(dim=(1, 2)), torch.ones(3))
