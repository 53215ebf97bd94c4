import math

import numpy as np
import pytest
import torch
from scipy.linalg import expm, logm
from torch import Tensor
from torch.autograd import gradcheck

from rendezvous.geometry.se2 import SE2, wrap_angle
from rendezvous.models import lie

TURNS_RAD = [0.0, 1e-12, -1e-7, 1e-3, 0.0499, -0.0501, 0.4, -1.7, 3.0, 3.1415, -3.1415]
"""Around zero, on both sides of where the series ends, and up to the half turn."""


def with_turns(turns_rad: list[float]) -> Tensor:
    """(B, 3) float64, a twist or a pose of each turn, with a shift of metres."""
    rng = np.random.default_rng(0)
    shifts_m = torch.from_numpy(rng.uniform(-3.0, 3.0, (len(turns_rad), 2)))
    return torch.cat([shifts_m, torch.tensor(turns_rad, dtype=torch.float64)[:, None]], dim=1)


def algebra_matrix(xi: Tensor) -> np.ndarray:
    v_x, v_y, turn = xi.tolist()
    return np.array([[0.0, -turn, v_x], [turn, 0.0, v_y], [0.0, 0.0, 0.0]])


def test_exp_is_the_exponential_of_the_matrix() -> None:
    xi_B3 = with_turns([*TURNS_RAD, 5.0, -9.0])
    for xi, pose in zip(xi_B3, lie.exp(xi_B3), strict=True):
        np.testing.assert_allclose(SE2(*pose.tolist()).matrix(), expm(algebra_matrix(xi)), atol=1e-12)


def test_log_is_the_logarithm_of_the_matrix() -> None:
    pose_B3 = with_turns(TURNS_RAD)
    for pose, xi in zip(pose_B3, lie.log(pose_B3), strict=True):
        # logm itself is good to about 1e-10 near a half turn, where two logarithms meet.
        np.testing.assert_allclose(algebra_matrix(xi), logm(SE2(*pose.tolist()).matrix()).real, atol=1e-8)


def test_log_undoes_exp_up_to_the_half_turn() -> None:
    xi_B3 = with_turns([*TURNS_RAD, math.pi])
    torch.testing.assert_close(lie.log(lie.exp(xi_B3)), xi_B3, atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("turns", [0, 1, -2])
def test_exp_undoes_log_whatever_turn_the_yaw_is_given_in(turns: int) -> None:
    pose_B3 = with_turns(TURNS_RAD)
    given_B3 = pose_B3 + torch.tensor([0.0, 0.0, 2.0 * math.pi * turns], dtype=torch.float64)
    torch.testing.assert_close(lie.exp(lie.log(given_B3)), pose_B3, atol=1e-12, rtol=0.0)


def test_single_precision_loses_no_digits_to_a_small_turn() -> None:
    poses_B3 = with_turns(list(np.geomspace(1e-8, 3.1, 400)))
    for mapped in (lie.exp, lie.log):
        gap = mapped(poses_B3.float()) - mapped(poses_B3)
        assert gap.abs().max() < 3e-6


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_gradients_are_the_finite_differences(turn_rad: float) -> None:
    at_B3 = with_turns([turn_rad]).requires_grad_()
    assert gradcheck(lie.exp, at_B3)
    assert gradcheck(lie.log, at_B3, eps=1e-7)


def test_the_gradient_at_the_identity_is_the_identity() -> None:
    for mapped in (lie.exp, lie.log):
        jacobian_33 = torch.autograd.functional.jacobian(mapped, torch.zeros(3))
        torch.testing.assert_close(jacobian_33, torch.eye(3))


def test_second_derivatives_at_zero_are_finite() -> None:
    at_B3 = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    (first,) = torch.autograd.grad(lie.log(lie.exp(at_B3)).square().sum(), at_B3, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), at_B3)
    torch.testing.assert_close(second, torch.full((1, 3), 2.0, dtype=torch.float64))


def test_composition_and_inverse_are_those_of_se2() -> None:
    a_B3, b_B3 = with_turns(TURNS_RAD), with_turns(TURNS_RAD[::-1]).flip(0).neg()
    for a, b, product, back in zip(a_B3, b_B3, lie.compose(a_B3, b_B3), lie.inverse(a_B3), strict=True):
        T_a, T_b = SE2(*a.tolist()), SE2(*b.tolist())
        np.testing.assert_allclose(product.numpy(), (T_a @ T_b).as_array(), atol=1e-12)
        np.testing.assert_allclose(back.numpy(), T_a.inverse().as_array(), atol=1e-12)


def test_angles_wrap_as_in_the_rest_of_the_project() -> None:
    angles = [0.0, math.pi, -math.pi, 3.0 * math.pi, 3.2, -3.2, 100.0, 2.0 * math.pi]
    wrapped = lie.wrap(torch.tensor(angles, dtype=torch.float64))
    assert wrapped.tolist() == pytest.approx([wrap_angle(angle) for angle in angles], abs=1e-12)
