import itertools
import math

import numpy as np
import pytest
import torch
from scipy.linalg import expm, logm
from torch import Tensor, nn
from torch.autograd import gradcheck

from rendezvous.geometry.se2 import SE2
from rendezvous.models import lie
from rendezvous.models.frame_error_network import input_grid, output_pose
from rendezvous.models.losses import (
    frame_error_loss,
    lie_error,
    plain_error,
    regulariser,
    warp,
)
from rendezvous.models.table_one import ABLATION_ROWS
from tests.models.worlds import misplaced, rooms

CELL_M = 0.1
FRAME_ERRORS = [SE2(1.3, -0.6, 0.0), SE2(0.0, 0.0, 0.7), SE2(-1.1, 1.9, -0.75), SE2(0.4, 0.3, 3.0)]


def pose(theta: SE2) -> Tensor:
    return torch.from_numpy(theta.as_array()).float()[None]


def smooth_map(p_m: np.ndarray) -> np.ndarray:
    """(...,) in [-1, 1] at points (..., 2) [m]: like no turned or shifted copy of itself."""
    x, y = p_m[..., 0], p_m[..., 1]
    return np.exp(-((x - 1.0) ** 2) - 2.0 * y**2) - np.exp(-0.5 * (x + 1.5) ** 2 - (y - 2.0) ** 2)


def smooth_grid(T_map_v: SE2, *, cells: int = 96) -> Tensor:
    """(1, 1, H, W): the smooth map at the cells of a window, seen through a pose."""
    along_m = (np.arange(cells) + 0.5 - cells / 2) * CELL_M
    x, y = np.meshgrid(along_m, along_m)
    return torch.from_numpy(smooth_map(T_map_v @ np.stack([x, y], axis=-1))).float()[None, None]


@pytest.mark.parametrize("theta", FRAME_ERRORS)
def test_moving_map_0_by_the_frame_error_brings_it_onto_map_1_as_placed(theta: SE2) -> None:
    # placed(u) = aligned(θ⁻¹ u)
    map_0, placed = smooth_grid(SE2.identity()), smooth_grid(theta.inverse())
    theta_hat_13 = output_pose(lie.log(pose(theta)), lie_algebra=True)
    assert (map_0 - placed).abs().max() > 0.5
    torch.testing.assert_close(warp(map_0, theta_hat_13, cell_m=CELL_M), placed, atol=0.01, rtol=0.0)


@pytest.mark.parametrize("theta", FRAME_ERRORS)
def test_the_warp_agrees_with_the_windows_that_training_sees(theta: SE2) -> None:
    window = misplaced(rooms(np.random.default_rng(3)), theta, cells=192, cell_m=CELL_M)
    grid_12HW = input_grid(torch.from_numpy(window.cells)[None], cells=192)
    map_0, placed = grid_12HW[:, :1], grid_12HW[:, 1:]
    moved, moved_back = (warp(map_0, pose(each), cell_m=CELL_M) for each in (theta, theta.inverse()))

    def shared_walls(a: Tensor, b: Tensor) -> float:
        return float(((a > 0.3) & (b > 0.3)).sum() / (b > 0.3).sum())

    assert shared_walls(map_0, placed) < 0.4
    assert shared_walls(moved_back, placed) < 0.4
    assert shared_walls(moved, placed) > 0.7
    assert (moved.round() == placed).float().mean() > 0.97


def test_a_warp_by_whole_cells_is_a_shift_that_draws_in_the_unknown() -> None:
    grid = torch.randint(1, 3, (1, 2, 24, 24), generator=torch.Generator().manual_seed(0)).float()
    moved = warp(grid, pose(SE2(3 * CELL_M, -2 * CELL_M, 0.0)), cell_m=CELL_M)
    expected = torch.zeros_like(grid)
    expected[..., :-2, 3:] = grid[..., 2:, :-3]
    torch.testing.assert_close(moved, expected, atol=1e-4, rtol=0.0)


def test_a_warp_by_a_quarter_turn_turns_x_towards_y() -> None:
    grid = torch.zeros(1, 1, 24, 24)
    grid[0, 0, 12, 20:] = 1.0
    moved = warp(grid, pose(SE2(0.0, 0.0, math.pi / 2)), cell_m=CELL_M)
    expected = torch.zeros_like(grid)
    expected[0, 0, 20:, 11] = 1.0
    torch.testing.assert_close(moved, expected, atol=1e-4, rtol=0.0)


def test_autocast_does_not_move_the_warp() -> None:
    grid, theta_13 = smooth_grid(SE2.identity()), pose(FRAME_ERRORS[2])
    with torch.autocast("cpu", torch.bfloat16):
        under_autocast = warp(grid, theta_13, cell_m=CELL_M)
    assert torch.equal(under_autocast, warp(grid, theta_13, cell_m=CELL_M))


def test_the_gradient_of_the_warp_is_the_finite_difference() -> None:
    grid = smooth_grid(SE2.identity(), cells=12).double()
    at_13 = torch.tensor([[0.13, -0.21, 0.37]], dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda pose_13: warp(grid, pose_13, cell_m=CELL_M), at_13)


@pytest.mark.parametrize("theta", FRAME_ERRORS)
def test_the_loss_of_the_true_twist_is_zero(theta: SE2) -> None:
    assert lie_error(lie.log(pose(theta)), pose(theta)).item() < 1e-10
    assert plain_error(pose(theta), pose(theta)).item() == 0.0


@pytest.mark.parametrize("theta", FRAME_ERRORS)
def test_the_lie_loss_is_half_the_squared_logarithm_of_the_matrices(theta: SE2) -> None:
    v_x, v_y, turn = 0.7, -0.2, 0.5
    estimated = expm(np.array([[0.0, -turn, v_x], [turn, 0.0, v_y], [0.0, 0.0, 0.0]]))
    d = logm(estimated @ np.linalg.inv(theta.matrix())).real
    expected = 0.5 * (d[0, 2] ** 2 + d[1, 2] ** 2 + d[1, 0] ** 2)
    loss_1 = lie_error(torch.tensor([[v_x, v_y, turn]]).double(), pose(theta).double())
    assert loss_1.item() == pytest.approx(expected, rel=1e-5)


def test_the_plain_loss_counts_each_component_and_does_not_wrap() -> None:
    theta_13 = torch.tensor([[1.0, -2.0, 3.0]])
    loss_1 = plain_error(torch.tensor([[1.5, -1.0, -3.0]]), theta_13)
    assert loss_1.item() == pytest.approx(0.5 * (0.25 + 1.0 + 36.0))


class Recorder(nn.Module):
    """Stands for a network: answers with what it is given, and keeps what it was asked."""

    def __init__(self, *answers: Tensor) -> None:
        super().__init__()
        self.answers = list(answers)
        self.asked: list[Tensor] = []

    def forward(self, grid_B2HW: Tensor) -> Tensor:
        self.asked.append(grid_B2HW)
        return self.answers[len(self.asked) - 1]


@pytest.mark.parametrize("lie_algebra", [True, False])
def test_the_regulariser_asks_about_the_maps_that_the_first_answer_aligned(lie_algebra: bool) -> None:
    theta = FRAME_ERRORS[2]
    maps = torch.cat([smooth_grid(SE2.identity()), smooth_grid(theta.inverse())], dim=1)
    answer_13 = lie.log(pose(theta)) if lie_algebra else pose(theta)
    network = Recorder(answer_13, torch.tensor([[3.0, 4.0, 12.0]]))
    loss = frame_error_loss(network, maps, pose(theta), lie_algebra=lie_algebra, omega=0.5, cell_m=CELL_M)
    aligned = network.asked[1]
    assert torch.equal(aligned[:, 1], maps[:, 1])
    torch.testing.assert_close(aligned[:, 0], maps[:, 1], atol=0.01, rtol=0.0)
    assert loss.error.item() == pytest.approx(0.0, abs=1e-10)
    assert loss.reg.item() == pytest.approx(13.0)
    assert loss.total.item() == pytest.approx(6.5)


def test_without_the_regulariser_the_network_runs_once() -> None:
    network = Recorder(torch.tensor([[1.0, 0.0, 0.0]]))
    grid = torch.zeros(1, 2, 24, 24)
    loss = frame_error_loss(network, grid, torch.zeros(1, 3), lie_algebra=False, omega=0.0, cell_m=CELL_M)
    assert len(network.asked) == 1
    assert (loss.total.item(), loss.error.item(), loss.reg.item()) == (0.5, 0.5, 0.0)


def test_the_loss_is_the_mean_over_the_batch() -> None:
    xi_B3 = torch.tensor([[1.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    network = Recorder(xi_B3, torch.tensor([[0.0, 0.0, 2.0], [4.0, 0.0, 0.0]]))
    grid = torch.zeros(2, 2, 24, 24)
    loss = frame_error_loss(network, grid, torch.zeros(2, 3), lie_algebra=True, omega=1.0, cell_m=CELL_M)
    assert loss.error.item() == pytest.approx(0.25 * (1.0 + 9.0))
    assert loss.reg.item() == pytest.approx(3.0)


def test_the_regulariser_pulls_on_the_estimate_through_the_warp() -> None:
    maps = torch.cat([smooth_grid(SE2.identity(), cells=16), smooth_grid(SE2.identity(), cells=16)], dim=1)
    weights = torch.randn(3, maps.numel(), generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def network(grid_B2HW: Tensor) -> Tensor:
        return grid_B2HW.flatten(1) @ weights.T

    def reg(pose_13: Tensor) -> Tensor:
        return regulariser(network, maps.double(), pose_13, cell_m=CELL_M)

    at_13 = torch.tensor([[0.13, -0.07, 0.37]], dtype=torch.float64, requires_grad=True)
    (gradient_13,) = torch.autograd.grad(reg(at_13).sum(), at_13)
    assert gradient_13.abs().min() > 1e-3
    assert gradcheck(reg, at_13)


@pytest.mark.parametrize("lie_algebra", [True, False])
def test_both_answers_learn_from_the_regulariser(lie_algebra: bool) -> None:
    theta = FRAME_ERRORS[2]
    maps = torch.cat([smooth_grid(SE2.identity()), smooth_grid(theta.inverse())], dim=1)
    scale = torch.ones(3, requires_grad=True)
    first_13 = torch.tensor([[0.3, -0.2, 0.1]], requires_grad=True)

    def network(grid_B2HW: Tensor) -> Tensor:
        # The first answer as given, the second from what the maps have in common once map 0 is moved.
        return first_13 if grid_B2HW is maps else scale * grid_B2HW.prod(dim=1).sum()[None, None]

    loss = frame_error_loss(network, maps, pose(theta), lie_algebra=lie_algebra, omega=1.0, cell_m=CELL_M)
    by_first_13, by_scale_3 = torch.autograd.grad(loss.reg, [first_13, scale])
    assert by_first_13.abs().min() > 1e-3
    assert by_scale_3.abs().min() > 1e-3


def test_an_answer_of_exactly_zero_has_a_finite_gradient() -> None:
    answer_13 = torch.zeros(1, 3, requires_grad=True)
    network = Recorder(answer_13, answer_13)
    grid = torch.zeros(1, 2, 24, 24)
    loss = frame_error_loss(network, grid, torch.ones(1, 3), lie_algebra=True, omega=1.0, cell_m=CELL_M)
    (gradient_13,) = torch.autograd.grad(loss.total, answer_13)
    assert torch.isfinite(gradient_13).all()
    assert gradient_13.abs().max() > 0.5


def test_table_i_has_a_row_for_every_setting_of_the_three_switches() -> None:
    switches = [(row.vit, row.reg, row.lie) for row in ABLATION_ROWS]
    assert switches == list(itertools.product([False, True], repeat=3))
    assert len({row.name for row in ABLATION_ROWS}) == 8
    for row in ABLATION_ROWS:
        assert (row.omega > 0.0) == row.reg
        assert set(row.name.split("-")) == {
            "vit" if row.vit else "cnn",
            *(["reg"] if row.reg else []),
            *(["lie"] if row.lie else []),
        }
