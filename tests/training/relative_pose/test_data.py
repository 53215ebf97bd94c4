"""Samples for the pose network: the same whoever draws them, and labelled where the robot is."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import cv2
import numpy as np
import pytest
import torch

from rendezvous.errors import ConfigError, StoreError
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.training.batches import training_loader
from rendezvous.training.relative_pose.data import (
    PoseTrainingBatches,
    draw_close_look,
    draw_look_elsewhere,
    draw_wide_look,
    pose_batch,
    span_px,
    target_maps,
    validation_samples,
)
from rendezvous.training.relative_pose.poses import PoseTable
from rendezvous.training.relative_pose.sampling import ImageAugmentation, PoseSampling, augmented_image
from tests.synthetic import CAMERA
from tests.synthetic_dataset import POSE_ROWS

PLAIN = ImageAugmentation(
    gain=0.0,
    offset=0.0,
    gamma=0.0,
    grey_share=0.0,
    blur_share=0.0,
    noise_share=0.0,
    jpeg_share=0.0,
    patch_share=0.0,
)
SAMPLING = PoseSampling()
SIZE_PX = (CAMERA.width_px, CAMERA.height_px)
SHOWING = [row for rows in POSE_ROWS for row in rows if row["T_c_o"] is not None]


def batches(poses: PoseTable, sampling: PoseSampling = SAMPLING, **options) -> PoseTrainingBatches:
    return PoseTrainingBatches(poses, sampling, **({"seed": 0, "batch_size": 3} | options))


def loaded(source: PoseTrainingBatches, *, count: int, first_step: int = 0, workers: int = 0):
    loader = training_loader(source, first_step=first_step, workers=workers, pin_memory=False)
    return list(islice(loader, count))


def same(one, other) -> bool:
    return all(torch.equal(one[key], other[key]) for key in one)


def test_any_number_of_workers_gives_the_same_batches_in_order(poses: PoseTable):
    alone, two = (loaded(batches(poses), count=5, workers=workers) for workers in (0, 2))
    assert all(same(a, b) for a, b in zip(alone, two, strict=True))
    assert not same(alone[0], alone[1])


def test_a_sample_does_not_depend_on_those_before_it(poses: PoseTable):
    forward, backward = batches(poses), batches(poses)
    there = [forward.sample(number) for number in range(60)]
    back = [backward.sample(number) for number in reversed(range(60))][::-1]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(there, back, strict=True))
    assert not np.array_equal(there[0].image, batches(poses, seed=1).sample(0).image)


def test_another_seed_gives_other_looks_at_the_same_images(poses: PoseTable):
    one, other = batches(poses), batches(poses, seed=1)
    other._orders = one._orders
    assert not any(np.array_equal(one.sample(n).image, other.sample(n).image) for n in range(3))
    looks = (validation_samples(poses, PoseSampling(), seed=seed, count=5) for seed in (0, 1))
    assert any(not np.array_equal(a.image, b.image) for a, b in zip(*looks, strict=False))


def test_processes_share_what_one_would_see_in_larger_batches(poses: PoseTable):
    whole = batches(poses, batch_size=6)[1]
    shares = [batches(poses, rank=rank, processes=2)[1] for rank in (0, 1)]
    assert all(torch.equal(torch.cat([share[key] for share in shares]), whole[key]) for key in whole)


def test_a_batch_is_what_networks_are_promised(poses: PoseTable):
    batch = batches(poses)[0]
    assert (batch["image_B3HW"].dtype, batch["image_B3HW"].shape) == (torch.uint8, (3, 3, 160, 160))
    assert (batch["belief_B9hw"].dtype, batch["belief_B9hw"].shape) == (torch.float32, (3, 9, 20, 20))
    assert (batch["fields_B16hw"].dtype, batch["fields_B16hw"].shape) == (torch.float32, (3, 16, 20, 20))


@pytest.mark.parametrize("kind", ["close", "wide"])
def test_labels_are_the_cuboid_projected_by_the_camera_of_the_look(kind: str):
    rng = np.random.default_rng(0)
    for row in SHOWING:
        uv_px = row["projected_cuboid_px"]
        if kind == "close":
            look = draw_close_look(uv_px, SAMPLING, rng)
        else:
            look = draw_wide_look(SIZE_PX, uv_px, SAMPLING, rng)
        camera = CAMERA.K() * look.scale
        camera[:2, 2] += look.offset_px
        p_c = np.array([row["T_c_o"] @ [*p, 1.0] for p in _cuboid_points(row["cuboid_size_m"])])[:, :3]
        brute_px = (p_c @ camera.T)[:, :2] / p_c[:, 2:]
        assert look.to_input(project_cuboid(row["T_c_o"], tuple(row["cuboid_size_m"]), CAMERA)) == (
            pytest.approx(brute_px, abs=1e-9)
        )


def _cuboid_points(size_m: np.ndarray) -> np.ndarray:
    """Written down from DOPE's drawing: front is +x, right is -y."""
    x, y, z = 0.5 * size_m
    front, rear = [(x, -y, z), (-x, -y, z), (-x, y, z), (x, y, z)], [(x, -y), (-x, -y), (-x, y), (x, y)]
    return np.array([*front, *((u, v, -z) for u, v in rear), (0.0, 0.0, 0.0)])


def test_labels_lie_on_the_robot_that_the_input_shows(poses: PoseTable):
    source = batches(poses, PoseSampling(augmentation=PLAIN))
    seen = [sample for sample in map(source.sample, range(60)) if sample.shows_robot]
    assert len(seen) > 30
    for sample in seen:
        hull = cv2.convexHull(sample.uv_px.astype(np.float32))
        distance_px = np.array(
            [[cv2.pointPolygonTest(hull, (u, v), True) for u in range(0, 160, 4)] for v in range(0, 160, 4)]
        )
        pixels = sample.image[::4, ::4].astype(float)
        # Painted in one colour; the wall is of another; beyond the image it is black.
        on_image = pixels.max(axis=2) > 0.0
        inside, outside = pixels[on_image & (distance_px > 4.0)], pixels[on_image & (distance_px < -4.0)]
        if len(inside):
            colour = np.median(inside, axis=0)
            assert np.mean(np.abs(inside - colour).max(axis=1) < 20.0) > 0.9
            assert np.sum(np.abs(outside - colour).max(axis=1) < 3.0) <= 0.01 * len(outside)


def test_looks_elsewhere_show_nothing_of_the_robot():
    rng = np.random.default_rng(0)
    looks = [
        (draw_look_elsewhere(SIZE_PX, row["projected_cuboid_px"], SAMPLING, rng), row) for row in SHOWING * 3
    ]
    drawn = [(look, row) for look, row in looks if look is not None]
    assert len(drawn) > 0.8 * len(looks)
    for look, row in drawn:
        points_px = look.to_input(row["projected_cuboid_px"])
        low, high = points_px.min(axis=0), points_px.max(axis=0)
        assert (high < 0.0).any() or (low > 159.0).any()


def test_wide_looks_show_little_beyond_the_image_and_spans_within_their_bounds():
    rng = np.random.default_rng(0)
    spans_px = []
    for row in SHOWING * 4:
        uv_px = row["projected_cuboid_px"]
        look = draw_wide_look(SIZE_PX, uv_px, SAMPLING, rng)
        spans_px.append(look.scale * span_px(uv_px))
        assert SAMPLING.least_scale <= look.scale <= SAMPLING.greatest_scale
        for axis, size_px in enumerate(SIZE_PX):
            first, last = look.to_image(np.array([[-0.5, -0.5], [159.5, 159.5]]))[:, axis]
            whole = first <= -0.5 + 1e-6 and last >= size_px - 0.5 - 1e-6
            assert whole or (first >= -0.5 - 1e-6 and last <= size_px - 0.5 + 1e-6)
    free = [span for span in spans_px if span < SAMPLING.greatest_span_px + 1e-6]
    assert len(free) > 0.95 * len(spans_px)
    assert min(spans_px) < 20.0
    assert max(free) > 120.0


def test_close_looks_show_the_robot_in_the_middle_at_the_span_for_measuring():
    rng = np.random.default_rng(0)
    middles, spans_px = [], []
    for row in SHOWING * 10:
        points_px = draw_close_look(row["projected_cuboid_px"], SAMPLING, rng).to_input(
            row["projected_cuboid_px"]
        )
        middles.append(0.5 * (points_px[:8].min(axis=0) + points_px[:8].max(axis=0)))
        spans_px.append(span_px(points_px))
    assert np.mean(middles, axis=0) == pytest.approx([79.5, 79.5], abs=2.0)
    assert np.std(middles, axis=0) == pytest.approx([10.0, 10.0], rel=0.15)
    assert np.median(spans_px) == pytest.approx(SAMPLING.close_span_px, rel=0.05)


@pytest.mark.parametrize(("share", "modes"), [(1.0, {True}), (0.0, {False}), (0.5, {True, False})])
def test_looks_are_at_plausible_images_as_often_as_asked_for(poses: PoseTable, monkeypatch, share, modes):
    asked, read = list[int](), PoseTable.__getitem__
    monkeypatch.setattr(PoseTable, "__getitem__", lambda self, row: asked.append(row) or read(self, row))
    source = batches(poses, replace(SAMPLING, plausible_share=share, absent_share=0.0))
    for number in range(30):
        source.sample(number)
    assert {bool(poses.plausible[row]) for row in asked} == modes


def test_looks_without_the_robot_keep_off_it_and_half_are_of_images_without_it(poses: PoseTable, monkeypatch):
    asked = list[tuple[bool, bool]]()

    def look(size_px, uv_px, sampling, rng):
        asked.append((shown[-1], bool(np.isfinite(uv_px).all())))
        return draw_look_elsewhere(size_px, uv_px, sampling, rng)

    shown, read = list[bool](), PoseTable.__getitem__

    def row(self, index):
        shown.append(bool(self.visibility[index] > 0.0))
        return read(self, index)

    monkeypatch.setattr("rendezvous.training.relative_pose.data.draw_look_elsewhere", look)
    monkeypatch.setattr(PoseTable, "__getitem__", row)
    source = batches(poses, replace(SAMPLING, absent_share=0.95, augmentation=PLAIN))
    for number in range(120):
        source.sample(number)
    assert all(visible == avoided for visible, avoided in asked)
    assert 0.35 < np.mean([visible for visible, _ in asked]) < 0.65


def test_targets_peak_at_the_points_and_point_to_the_centroid():
    uv_px = np.random.default_rng(0).uniform(-30.0, 190.0, (9, 2))
    belief, fields = target_maps(uv_px, SAMPLING)
    rows, cols = np.mgrid[:20, :20]
    for channel, (u, v) in enumerate(uv_px):
        if not (-0.5 <= u < 159.5 and -0.5 <= v < 159.5):
            assert not belief[channel].any()
            continue
        gap = np.hypot(cols - u / 8.0, rows - v / 8.0)
        expected = np.exp(-0.5 * gap**2)
        shown = belief[channel] > 0.0
        assert belief[channel][shown] == pytest.approx(expected[shown], abs=1e-6)
        assert shown[gap < 2.0].all()
    for channel, point in enumerate(uv_px[:8]):
        x, y = fields[2 * channel], fields[2 * channel + 1]
        shown = (x != 0.0) | (y != 0.0)
        towards = uv_px[8] - point
        assert x[shown] == pytest.approx(towards[0] / np.hypot(*towards), abs=1e-6)
        assert y[shown] == pytest.approx(towards[1] / np.hypot(*towards), abs=1e-6)


def test_augmentation_keeps_pixels_in_place_and_patches_within_their_size():
    rng = np.random.default_rng(0)
    image = np.full((160, 160, 3), 100, np.uint8)
    image[40:120, 60:100] = 220
    box_px = np.array([[60.0, 40.0], [100.0, 120.0]])
    wild = ImageAugmentation(blur_share=1.0, noise_share=1.0, jpeg_share=1.0, patch_share=0.0)
    for _ in range(20):
        found = augmented_image(image, box_px, wild, rng).astype(float).mean(axis=2)
        edges = [found[80, 40:120], found[20:140, 80]]
        rise = [int(np.argmax(np.abs(np.convolve(edge, [1, 1, -1, -1], "valid")))) + 1 for edge in edges]
        assert rise[0] in {*range(17, 23), *range(57, 63)}
        assert rise[1] in {*range(17, 23), *range(97, 103)}
    patched = PLAIN.__class__(**{**_values(PLAIN), "patch_share": 1.0, "patches": 1})
    changed = [(augmented_image(image, box_px, patched, rng) != image).any(axis=2) for _ in range(50)]
    assert max(mask.any(axis=0).sum() for mask in changed) <= 0.4 * 80.0 + 1.0
    assert sum(mask[40:120, 60:100].any() for mask in changed) > 25
    assert np.array_equal(augmented_image(image, box_px, PLAIN, rng), image)


def _values(record) -> dict:
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def test_validation_looks_are_always_the_same_and_untouched(poses: PoseTable):
    wild, plain = (
        validation_samples(poses, PoseSampling(augmentation=augmentation), seed=0, count=5)
        for augmentation in (ImageAugmentation(patch_share=1.0), PLAIN)
    )
    assert same(pose_batch(wild, SAMPLING), pose_batch(plain, SAMPLING))
    assert [sample.close for sample in plain].count(True) == 5


def test_a_split_that_shows_no_robot_is_told(poses: PoseTable):
    with pytest.raises(StoreError, match=r"^poses/train: none of \d+ images shows at least 1 of the robot"):
        batches(poses, PoseSampling(least_visibility=1.0))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"input_px": 150}, "input_px is 150; must be a multiple of 8"),
        ({"least_span_px": 150.0}, "least_span_px is 150.0; must be from 1 to 140"),
        ({"absent_share": 1.0}, "absent_share is 1.0; must be from 0 to 0.95"),
    ],
)
def test_wrong_settings_are_told(settings: dict, said: str):
    with pytest.raises(ConfigError, match=said):
        PoseSampling(**settings)


@pytest.mark.parametrize(
    ("share", "means", "deviation"),
    [
        ("patch_share", [140.38, 133.50, 125.48], 24.79),
        ("blur_share", [111.15, 103.77, 94.64], 22.59),
        ("grey_share", [105.25, 105.12, 107.38], 19.21),
        ("noise_share", [111.40, 103.11, 97.25], 24.38),
        ("jpeg_share", [112.62, 103.67, 97.78], 23.39),
    ],
)
def test_inputs_are_augmented_as_they_were(share: str, means: list[float], deviation: float):
    """As for the shipped weights, within what codecs and processors differ by."""
    image = np.full((160, 160, 3), 100, np.uint8)
    image[40:120, 60:100] = (220, 150, 80)
    shares = dict.fromkeys(("patch_share", "blur_share", "grey_share", "noise_share", "jpeg_share"), 0.0)
    parameters = ImageAugmentation(**(shares | {share: 1.0}))
    box_px = np.array([[60.0, 40.0], [100.0, 120.0]])
    found = augmented_image(image, box_px, parameters, np.random.default_rng(3)).astype(float)
    assert found.mean(axis=(0, 1)) == pytest.approx(means, abs=0.3)
    assert found.std() == pytest.approx(deviation, abs=0.3)


@pytest.mark.parametrize(
    ("draw", "scale", "offset_px"),
    [
        (draw_wide_look, 1.7209371, (-477.99215, -248.72123)),
        (lambda size_px, *drawn: draw_close_look(*drawn), 1.9925590, (-574.59958, -390.49854)),
        (draw_look_elsewhere, 2.6041648, (-771.40991, -1089.19704)),
    ],
)
def test_looks_are_drawn_as_they_were(draw, scale: float, offset_px: tuple[float, float]):
    front = np.array([[300.0, 200.0], [340.0, 200.0], [340.0, 260.0], [300.0, 260.0]])
    uv_px = np.vstack([front, front + 10.0, [[325.0, 235.0]]])
    look = draw((640, 480), uv_px, SAMPLING, np.random.default_rng(4))
    assert (look.scale, *look.offset_px) == pytest.approx((scale, *offset_px), rel=1e-6)
