from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from rendezvous.errors import PipelineError
from rendezvous.evaluation.pictures.canvas import SHEET_WIDTH_PX
from rendezvous.evaluation.pictures.poses import (
    CUBOID_COLOUR,
    FRONT_COLOUR,
    labelled_image,
    pose_sheet,
    visibility_words,
)
from rendezvous.geometry.camera import PinholeCamera, camera_pose, se3_from_se2
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.se2 import SE2

CAMERA = PinholeCamera(fx_px=616.0, fy_px=616.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480)
SIZE_M = (0.3, 0.2, 0.1)
GREY = 90
T_R0_C = camera_pose(np.array([0.0, 0.0, 0.4]), np.array([0.0, 0.3, 0.0]))


def _row(x_m: float, y_m: float = 0.0, yaw_rad: float = 0.5, *, form: str = ".jpg") -> dict:
    """A plain grey image, in which the robot is said to stand at a pose in r0."""
    T_c_o = np.linalg.inv(T_R0_C) @ se3_from_se2(SE2(x_m, y_m, yaw_rad))
    uv_px = project_cuboid(T_c_o, SIZE_M, CAMERA)
    grey = np.full((CAMERA.height_px, CAMERA.width_px, 3), GREY, np.uint8)
    known = uv_px[np.isfinite(uv_px).all(axis=1)]
    box_px = np.concatenate([known.min(axis=0), known.max(axis=0)]).clip(-0.5, [639.5, 479.5] * 2)
    return {
        "pose_id": "plan-0-p0001",
        "plan_id": "plan-0",
        "mode": "plausible",
        "image": cv2.imencode(form, grey)[1].tobytes(),
        "T_c_o": T_c_o,
        "projected_cuboid_px": uv_px,
        "box_px": box_px,
        "visibility": 0.87,
    }


ABSENT = {"T_c_o": None, "projected_cuboid_px": None, "box_px": None, "visibility": 0.0}
BARE = {"box_px": None}
"""Without the box, whose lines could pass for others."""


def _drawn(row: dict, width_px: int = 640) -> np.ndarray:
    return labelled_image(row, width_px=width_px)


def _near(image, uv_px, colour) -> bool:
    """Whether a pixel within 1 of this place is nearer to the colour than the background is."""
    u, v = np.round(uv_px).astype(int)
    patch = image[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2].astype(float)
    gap = np.linalg.norm(patch - colour, axis=2)
    return bool(gap.size and gap.min() < 0.4 * np.linalg.norm(np.array(colour) - GREY))


def _mask(image, colour):
    return np.linalg.norm(image.astype(float) - colour, axis=2) < 60.0


@pytest.mark.parametrize("yaw_rad", [0.5, np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("width_px", [640, 320])
def test_corners_are_painted_where_opencv_projects_them_and_the_front_apart(width_px: int, yaw_rad: float):
    row = _row(0.9, yaw_rad=yaw_rad) | BARE
    image = _drawn(row, width_px)
    signs = np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, 8).T
    rotation, translation = cv2.Rodrigues(row["T_c_o"][:3, :3])[0], row["T_c_o"][:3, 3]
    uv_px = cv2.projectPoints(0.5 * signs * np.array(SIZE_M), rotation, translation, CAMERA.K(), None)[0]
    shown_px = (uv_px.reshape(8, 2) + 0.5) * width_px / 640 - 0.5
    assert image.shape == (width_px * 3 // 4, width_px, 3)
    for (x, _, _), corner_px in zip(signs, shown_px, strict=True):
        assert _near(image, corner_px, FRONT_COLOUR if x > 0 else CUBOID_COLOUR)
    u, v = np.round((row["projected_cuboid_px"][8] + 0.5) * width_px / 640 - 0.5).astype(int)
    assert _mask(image, FRONT_COLOUR)[v - 1 : v + 2, u - 1 : u + 2].all(), "the centroid is not marked"


def test_the_box_is_drawn_around_the_visible_pixels():
    row = _row(0.9) | {"projected_cuboid_px": None, "box_px": np.array([99.5, 149.5, 199.5, 299.5])}
    lines = np.nonzero((_drawn(row) > GREY + 60).all(axis=2))
    assert [axis.min() for axis in lines] == pytest.approx([149, 99], abs=1)
    assert [axis.max() for axis in lines] == pytest.approx([300, 200], abs=1)


def test_points_behind_the_camera_leave_the_rest_drawn():
    row = _row(0.9) | BARE
    whole = row["projected_cuboid_px"]
    image = _drawn(row | {"projected_cuboid_px": np.vstack([np.full(2, np.nan), whole[1:]])})
    assert not _near(image, whole[0], FRONT_COLOUR)
    assert all(_near(image, whole[i], FRONT_COLOUR if i in (3, 4, 7) else CUBOID_COLOUR) for i in range(1, 8))


@pytest.mark.parametrize("far_px", [1e4, 1e12])
def test_an_edge_that_leaves_the_image_is_drawn_up_to_its_border(far_px: float):
    uv_px = np.full((9, 2), np.nan)
    uv_px[1], uv_px[2] = (100.0, 200.0), (far_px, 200.0)
    drawn = _mask(_drawn(_row(0.9) | BARE | {"projected_cuboid_px": uv_px}), CUBOID_COLOUR)
    assert drawn[200, 101:].all()
    assert not drawn[:, :99].any()


@pytest.mark.parametrize("form", [".jpg", ".png"])
@pytest.mark.parametrize(
    "uv_px", [-50.0 * np.arange(1, 10)[:, None] * np.ones(2), np.full((9, 2), np.nan), None]
)
def test_a_cuboid_wholly_outside_unknown_or_absent_leaves_no_mark(uv_px, form):
    image = _drawn(_row(0.9, form=form) | ABSENT | {"projected_cuboid_px": uv_px})
    assert np.abs(image.astype(int) - GREY).max() <= 2


def test_a_small_robot_is_magnified_in_the_corner_that_is_far_from_it():
    small, large = _row(3.5, -1.0), _row(0.9, -0.1)
    assert (small["projected_cuboid_px"][8] > (CAMERA.cx_px, 0)).all()
    assert small["projected_cuboid_px"][8, 1] < CAMERA.cy_px
    lower_left = [_drawn(row)[-200:, :200] for row in (small, large)]
    assert not _mask(lower_left[1], CUBOID_COLOUR).any()
    magnified_px = np.ptp(np.argwhere(_mask(lower_left[0], CUBOID_COLOUR)), axis=0)
    assert magnified_px.max() > 1.5 * np.ptp(small["projected_cuboid_px"], axis=0).max()


def test_a_sheet_says_where_there_is_no_robot():
    rows = (_row(1.0), _row(1.0) | ABSENT)
    assert [visibility_words(row) for row in rows] == ["87% visible", "no robot"]
    present, absent = (pose_sheet([row], title="Poses")[-44:] for row in rows)
    assert absent.min() < GREY
    assert (present != absent).any()


def test_a_sheet_has_four_images_to_a_line():
    shapes = [pose_sheet([_row(1.0)] * n, title="Poses").shape for n in (1, 4, 5, 8, 9)]
    assert {width for _, width, _ in shapes} == {SHEET_WIDTH_PX}
    steps = [b[0] - a[0] for a, b in pairwise(shapes)]
    assert steps[0] == steps[2] == 0
    assert steps[1] == steps[3] > 200


def test_an_image_that_cannot_be_decoded_is_named():
    with pytest.raises(PipelineError, match="plan-0-p0001: its image cannot be decoded; must be JPEG or PNG"):
        pose_sheet([_row(1.0) | {"image": b"text"}], title="Poses")
