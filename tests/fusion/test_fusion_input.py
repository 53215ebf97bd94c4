"""Several images of one sighting made one: laws of normal distributions, and images that contradict."""

import math

import numpy as np
import pytest

from rendezvous.alignment.frame_error import log_density
from rendezvous.errors import SightingError
from rendezvous.fusion.fusion_input import SightedPose, SlamSpread, sighted_pose
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose

TRUE = SE2(1.6, -0.3, 2.5)
SHAPE = np.array([[0.010, 0.004, 0.001], [0.004, 0.006, -0.001], [0.001, -0.001, 0.003]])


def pose_of(*modes: tuple[SE2, Array, float], score: float = 0.9) -> RelativePose:
    """An estimate from one image."""
    return RelativePose(
        modes=tuple(PoseMode(T_r0_r1=T, covariance=c, mass=p, T_c_o=np.eye(4)) for T, c, p in modes),
        score=score,
        keypoints_px=np.zeros((9, 2)),
    )


def seen_at(T: SE2, covariance: Array = SHAPE, *, score: float = 0.9) -> RelativePose:
    return pose_of((T, covariance, 1.0), score=score)


def test_one_image_is_taken_as_it_is():
    flipped = TRUE @ SE2(0.0, 0.0, math.pi)
    sighting = sighted_pose([pose_of((TRUE, SHAPE, 0.8), (flipped, SHAPE, 0.2), score=0.7)])
    assert [mode.mass for mode in sighting.modes] == pytest.approx([0.8, 0.2])
    assert sighting.best.T_r0_r1 == TRUE
    assert sighting.score == 0.7
    assert sighting.contradicted_by == ()


def test_the_same_image_many_times_has_the_same_mean_and_a_smaller_covariance():
    sighting = sighted_pose([seen_at(TRUE)] * 4)
    assert (TRUE.inverse() @ sighting.best.T_r0_r1).wrapped().as_array() == pytest.approx(
        np.zeros(3), abs=1e-12
    )
    assert sighting.best.covariance == pytest.approx(SHAPE / 4.0)
    assert sighting.best.images == (0, 1, 2, 3)


def test_a_hundred_images_are_combined_and_those_that_contradict_them_left_out():
    """Their product of densities is beyond what doubles hold."""
    fine = 1e-4 * np.eye(3)
    images = [seen_at(TRUE, fine)] * 100
    images[3] = images[40] = seen_at(TRUE @ SE2(2.0, 0.0, 0.0), fine)
    sighting = sighted_pose(images)
    assert sighting.contradicted_by == (3, 40)
    assert sighting.best.mass == pytest.approx(1.0)
    assert sighting.best.covariance == pytest.approx(fine / 98.0)


def test_several_images_have_lighter_tails_than_one():
    """As densities do: far out, the product of t densities falls as that of the reported degrees of
    freedom."""
    heavy = PoseMode(T_r0_r1=TRUE, covariance=np.eye(3), mass=1.0, T_c_o=np.eye(4), degrees_of_freedom=5.0)
    light = PoseMode(T_r0_r1=TRUE, covariance=np.eye(3), mass=1.0, T_c_o=np.eye(4), degrees_of_freedom=9.0)
    images = [
        RelativePose(modes=(mode,), score=0.9, keypoints_px=np.zeros((9, 2))) for mode in (heavy, light)
    ]
    assert sighted_pose(images[:1]).best.degrees_of_freedom == 5.0
    together = sighted_pose(images).best.degrees_of_freedom

    def slope(degrees_of_freedom: float) -> float:
        far = np.array([[1e4, 0.0, 0.0], [2e4, 0.0, 0.0]])
        logs = log_density(far, np.tile(np.eye(3), (2, 1, 1)), np.full(2, degrees_of_freedom))
        return float((logs[1] - logs[0]) / math.log(2.0))

    assert slope(together) == pytest.approx(slope(5.0) + slope(9.0), rel=1e-4)
    assert math.isinf(sighted_pose([seen_at(TRUE), images[0]]).best.degrees_of_freedom)


def test_the_product_has_the_largest_product_of_densities():
    """Against a search: no pose around it makes both images more probable."""
    others = TRUE @ SE2(0.06, -0.05, 0.08), np.diag([0.004, 0.02, 0.01])
    sighting = sighted_pose([seen_at(TRUE), seen_at(*others)])

    def cost(T: SE2) -> float:
        d = [(mean.inverse() @ T).wrapped().as_array() for mean in (TRUE, others[0])]
        return sum(e @ np.linalg.solve(c, e) for e, c in zip(d, (SHAPE, others[1]), strict=True))

    least = cost(sighting.best.T_r0_r1)
    rng = np.random.default_rng(0)
    for d in rng.normal(0.0, 0.01, (200, 3)):
        assert cost(sighting.best.T_r0_r1 @ SE2.from_array(d)) > least


def test_order_does_not_matter():
    images = [seen_at(TRUE @ SE2.from_array(d)) for d in np.random.default_rng(1).normal(0.0, 0.05, (3, 3))]
    forth, back = sighted_pose(images).best, sighted_pose(images[::-1]).best
    difference = (forth.T_r0_r1.inverse() @ back.T_r0_r1).wrapped()
    assert difference.as_array() == pytest.approx(np.zeros(3), abs=1e-9)
    assert forth.covariance == pytest.approx(back.covariance)


def test_a_second_image_tells_front_from_back():
    flipped = TRUE @ SE2(0.0, 0.0, math.pi)
    sighting = sighted_pose([pose_of((flipped, SHAPE, 0.55), (TRUE, SHAPE, 0.45)), seen_at(TRUE)])
    assert abs((TRUE.inverse() @ sighting.best.T_r0_r1).wrapped().yaw_rad) < 0.01
    assert sighting.best.mass > 0.99


def test_two_images_that_contradict_each_other_are_told_and_not_averaged():
    away = TRUE @ SE2(2.0, 0.0, 0.0)
    sighting = sighted_pose([seen_at(TRUE), seen_at(away)])
    assert len(sighting.contradicted_by) == 1
    assert [mode.mass for mode in sighting.modes] == pytest.approx([0.5, 0.5], abs=1e-6)
    found = sorted((TRUE.inverse() @ mode.T_r0_r1).x_m for mode in sighting.modes)
    assert found == pytest.approx([0.0, 2.0], abs=1e-9)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_image_that_contradicts_two_others_is_left_out(place: int):
    images = [seen_at(TRUE)] * 2
    images.insert(place, seen_at(TRUE @ SE2(2.0, 0.0, 0.0)))
    sighting = sighted_pose(images)
    assert sighting.contradicted_by == (place,)
    assert sighting.best.mass > 0.9
    assert sighting.best.covariance == pytest.approx(SHAPE / 2.0)


def test_images_without_the_robot_are_passed_over():
    sighting = sighted_pose([RelativePose.not_found("no peaks"), seen_at(TRUE, score=0.6)])
    assert sighting.found_in == sighting.best.images == (1,)
    assert sighting.score == 0.6


def test_no_image_with_the_robot_is_an_error_that_says_why():
    with pytest.raises(SightingError, match=r"none of 2 images \(image 0: too dark; image 1: no peaks\)"):
        sighted_pose([RelativePose.not_found("too dark"), RelativePose.not_found("no peaks")])


def test_a_given_pose_has_no_score():
    assert SightedPose.given(TRUE).score is None
    assert SightedPose.given(TRUE).best.covariance is None


def test_readings_are_as_probable_as_their_densities_and_mistakes_make_them():
    """Two images 60 cm apart: both right, either one mistaken; a mistaken one is somewhere in 75 m² rad."""
    apart = SE2(0.6, 0.0, 0.0)
    sighting = sighted_pose([seen_at(TRUE), seen_at(TRUE @ apart)])
    (log_together,) = log_density(apart.as_array()[None], 2.0 * SHAPE[None], np.array([math.inf]))
    masses = {
        (0, 1): 0.98 * 0.98 * math.exp(log_together),
        (0,): 0.98 * 0.02 / 75.0,
        (1,): 0.98 * 0.02 / 75.0,
    }
    total = sum(masses.values())
    assert 0.01 < masses[0, 1] / total < 0.99
    found = {mode.images: mode.mass for mode in sighting.modes}
    assert found == pytest.approx({images: mass / total for images, mass in masses.items()})


def test_the_score_is_that_of_the_images_that_are_believed():
    images = [seen_at(TRUE, score=0.6), seen_at(TRUE, score=0.7)]
    images.append(seen_at(TRUE @ SE2(2.0, 0.0, 0.0), score=0.95))
    assert sighted_pose(images).score == 0.7


def test_of_many_readings_the_sixteen_most_probable_are_kept():
    masses = np.arange(20, 0, -1) / 210.0
    modes = [(TRUE @ SE2(0.1 * k, 0.0, 0.0), SHAPE, float(p)) for k, p in enumerate(masses)]
    kept = sighted_pose([pose_of(*modes)]).modes
    assert [mode.mass for mode in kept] == pytest.approx(masses[:16] / masses[:16].sum())
    assert sum(mode.mass for mode in kept) == pytest.approx(1.0)
    two = sighted_pose([pose_of((TRUE, SHAPE, 0.99995), (TRUE @ SE2(1.0, 0.0, 0.0), SHAPE, 5e-5))])
    assert len(two.modes) == 1


def test_a_robots_own_pose_is_known_to_two_centimetres_and_half_a_degree():
    heading = math.radians(0.5)
    assert SlamSpread().covariance() == pytest.approx(np.diag([4e-4, 4e-4, heading**2]))
