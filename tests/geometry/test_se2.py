import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytest import approx

from rendezvous.errors import PipelineError
from rendezvous.geometry.se2 import SE2, wrap_angle

length_m = st.floats(-50.0, 50.0)
poses = st.builds(SE2, length_m, length_m, st.floats(-7.0, 7.0))


def same(a: SE2, b: SE2) -> bool:
    gap = a.as_array() - b.as_array()
    return bool(np.hypot(*gap[:2]) < 1e-9 and abs(wrap_angle(gap[2])) < 1e-9)


@given(poses, poses, poses)
def test_composition_is_associative(a: SE2, b: SE2, c: SE2) -> None:
    assert same((a @ b) @ c, a @ (b @ c))


@given(poses)
def test_inverse_undoes(a: SE2) -> None:
    assert same(a @ a.inverse(), SE2.identity())
    assert same(a.inverse() @ a, SE2.identity())


@given(poses, poses)
def test_matrix_is_a_homomorphism(a: SE2, b: SE2) -> None:
    np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)


@given(poses, poses)
def test_carrying_points_agrees_with_composition(a: SE2, b: SE2) -> None:
    p = np.array([[1.0, 2.0], [-3.0, 0.5]])
    np.testing.assert_allclose((a @ b) @ p, a @ (b @ p), atol=1e-9)


def test_a_quarter_turn_carries_x_to_y() -> None:
    p = SE2(1.0, 0.0, math.pi / 2) @ np.array([1.0, 0.0])
    assert p == approx([1.0, 1.0], abs=1e-12)


@pytest.mark.parametrize(
    ("angle_rad", "wrapped_rad"),
    [(0.0, 0.0), (math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (2 * math.pi + 0.1, 0.1)],
)
def test_angles_wrap_to_the_half_open_turn(angle_rad: float, wrapped_rad: float) -> None:
    assert wrap_angle(angle_rad) == approx(wrapped_rad)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_pose_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(PipelineError, match="is not finite"):
        SE2(0.0, value, 0.0)


def test_a_pose_holds_plain_numbers_whatever_it_was_made_of():
    pose = SE2(np.float64(1.5), np.float32(-2.0), 3) @ SE2(np.float64(0.0), 0.0, 0.0)
    assert repr(pose) == "SE2(x_m=1.5, y_m=-2.0, yaw_rad=3.0)"


def test_a_pose_is_wrapped_in_its_heading_alone():
    assert SE2(1.0, -2.0, 1.5 * math.pi).wrapped().as_array() == approx([1.0, -2.0, -0.5 * math.pi])


@given(poses)
def test_a_pose_is_its_array(a: SE2) -> None:
    assert SE2.from_array(a.as_array()) == a
