"""The frame error: the rigid motion by which an estimated map transform is wrong (Kim, Han & Zhang, 2023).

The paper's Eq. 2 chains three poses into T̃, and its Eq. 3 corrects T̃ by `θ_error⁻¹`. There the error turns
about the origin of m0, so that a small error in heading moves a distant meeting point by metres. Here it is
conjugated to the window frame v at the meeting point: `θ_v = T_m0_v⁻¹ (T̃ T⁻¹) T_m0_v`. Seen from v, map 1 as
the estimate places it is θ_v applied to map 1 as it should lie. (The letter w is the floor plan's frame.)
"""

from __future__ import annotations

import numpy as np

from rendezvous.geometry.se2 import SE2


def initial_alignment(T_m0_r0: SE2, T_r0_r1: SE2, T_m1_r1: SE2) -> SE2:
    """T̃, the pose of map 1 in map 0 according to robot 0's sighting of robot 1 (Eq. 2)."""
    return (T_m0_r0 @ T_r0_r1 @ T_m1_r1.inverse()).wrapped()


def meeting_point(T_m0_m1: SE2, T_m1_r1: SE2) -> SE2:
    """The window's centre: where an estimate puts robot 1 in map 0, with the axes of m0 (yaw 0)."""
    T_m0_r1 = T_m0_m1 @ T_m1_r1
    return SE2(T_m0_r1.x_m, T_m0_r1.y_m, 0.0)


def frame_error(T_estimated: SE2, T_true: SE2, T_m0_v: SE2) -> SE2:
    """θ_v: the error of an estimated `T_m0_m1`, seen from the window frame v."""
    return (T_m0_v.inverse() @ T_estimated @ T_true.inverse() @ T_m0_v).wrapped()


def corrected(T_estimated: SE2, theta_v: SE2, T_m0_v: SE2) -> SE2:
    """T̂ = T_m0_v θ_v⁻¹ T_m0_v⁻¹ T̃, the estimated `T_m0_m1` without its frame error (Eq. 3)."""
    return (T_m0_v @ theta_v.inverse() @ T_m0_v.inverse() @ T_estimated).wrapped()


def perturbed(T_true: SE2, T_m0_r1: SE2, theta: SE2) -> tuple[SE2, SE2]:
    """T̃ and its meeting point such that T̃'s frame error there is theta.

    The centre must be where T̃, not the truth, puts robot 1: with P the true meeting point, `C = P + R_ψ⁻¹
    t`.

    Args:
        T_true: the true `T_m0_m1`.
        T_m0_r1: the true pose of robot 1 in map 0; only its position P matters.
        theta: the frame error (t, ψ) at C, in the axes of m0.
    """
    back = SE2(0.0, 0.0, -theta.yaw_rad) @ np.array([theta.x_m, theta.y_m])
    T_m0_v = SE2(T_m0_r1.x_m + float(back[0]), T_m0_r1.y_m + float(back[1]), 0.0)
    return (T_m0_v @ theta @ T_m0_v.inverse() @ T_true).wrapped(), T_m0_v


def pose_difference(theta_hat: SE2, theta: SE2) -> SE2:
    """θ̂⁻¹ θ with yaw in (-pi, pi]; its components are the error that every method reports."""
    return (theta_hat.inverse() @ theta).wrapped()
