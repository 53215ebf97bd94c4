"""The frame error: by which rigid motion an estimated map transform is wrong (Kim, Han & Zhang, 2023).

The paper's Eq. 2 chains three poses into T̃, and its Eq. 3 corrects it by `θ_error⁻¹`. There the error turns
about the origin of m0, so that a small error in heading moves a far meeting point by metres. Here it is
conjugated to a window frame w at the meeting point: `θ_w = T_m0_w⁻¹ (T̃ T⁻¹) T_m0_w`. Map 1 as the estimate
places it is then θ_w applied to map 1 as it should lie, both seen from w.
"""

from __future__ import annotations

import numpy as np

from rendezvous.geometry.se2 import SE2


def initial_alignment(T_m0_r0: SE2, T_r0_r1: SE2, T_m1_r1: SE2) -> SE2:
    """T̃, the pose of map 1 in map 0, from where robot 0 sees robot 1 (Eq. 2)."""
    return (T_m0_r0 @ T_r0_r1 @ T_m1_r1.inverse()).wrapped()


def meeting_point(T_m0_m1: SE2, T_m1_r1: SE2) -> SE2:
    """Where an estimate puts robot 1 in map 0: the window's centre, with the axes of m0 (yaw 0)."""
    T_m0_r1 = T_m0_m1 @ T_m1_r1
    return SE2(T_m0_r1.x_m, T_m0_r1.y_m, 0.0)


def frame_error(T_estimated: SE2, T_true: SE2, T_m0_w: SE2) -> SE2:
    """θ_w: the error of an estimated `T_m0_m1`, seen from the window frame w."""
    return (T_m0_w.inverse() @ T_estimated @ T_true.inverse() @ T_m0_w).wrapped()


def corrected(T_estimated: SE2, theta_w: SE2, T_m0_w: SE2) -> SE2:
    """T̂ = T_m0_w θ_w⁻¹ T_m0_w⁻¹ T̃, the estimated `T_m0_m1` free of its frame error (Eq. 3)."""
    return (T_m0_w @ theta_w.inverse() @ T_m0_w.inverse() @ T_estimated).wrapped()


def perturbed(T_true: SE2, T_m0_r1: SE2, theta: SE2) -> tuple[SE2, SE2]:
    """T̃ and its meeting point C such that the frame error of T̃ at C is the one that was drawn.

    The centre must be where T̃, not the truth, puts robot 1: with P the true meeting point, `C = P + R_ψ⁻¹ t`.

    Args:
        T_true: the true `T_m0_m1`.
        T_m0_r1: the true pose of robot 1 in map 0; only its position P matters.
        theta: the frame error (t, ψ) at C, in the axes of m0.
    """
    back = SE2(0.0, 0.0, -theta.yaw_rad) @ np.array([theta.x_m, theta.y_m])
    T_m0_c = SE2(T_m0_r1.x_m + float(back[0]), T_m0_r1.y_m + float(back[1]), 0.0)
    return (T_m0_c @ theta @ T_m0_c.inverse() @ T_true).wrapped(), T_m0_c


def pose_difference(theta_hat: SE2, theta: SE2) -> SE2:
    """θ̂⁻¹ θ, yaw in (-pi, pi]: its components are what all methods report as their error."""
    return (theta_hat.inverse() @ theta).wrapped()
