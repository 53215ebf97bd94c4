"""Benchmarks run on what they claim to measure."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.fuse import _Costs, _fuse, _medians_ms, _synthetic
from benchmarks.training import synthetic_pairs
from rendezvous.fusion.refinement import Refinement, correlative_refiner
from rendezvous.interop.camera_info import write_camera_info
from rendezvous.training.frame_error.data import TrainingBatches
from rendezvous.training.parameters import Sampling
from tests.commands.fuse.test_fuse import Seeing
from tests.synthetic import CAMERA


def test_samples_are_drawn_from_the_pairs_that_training_is_timed_on():
    batch = TrainingBatches(synthetic_pairs(), Sampling(), seed=0, batch_size=2)[0]
    assert batch["cells"].any()
    assert batch["theta"].abs().sum() > 0.0


def test_the_picture_of_the_robot_is_drawn_in_the_time_that_is_told(tmp_path: Path):
    sighting = _synthetic(tmp_path)
    write_camera_info(CAMERA, tmp_path / "camera.yaml")
    cv2.imwrite(str(tmp_path / "image.png"), np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8))
    costs = _Costs()
    _fuse(sighting, Seeing(*[sighting.T_r0_r1] * 2), {Refinement.NONE: None}, costs)
    assert {"read image", "see", "draw and write"} <= set(costs.cpu)
    assert (tmp_path / "out" / "image.png").is_file()


def test_every_part_of_a_fusion_is_timed_and_the_pair_is_one_that_can_be_fused(tmp_path: Path):
    costs = _Costs()
    refiners = {Refinement.NONE: None, Refinement.CORRELATIVE: correlative_refiner}
    _fuse(_synthetic(tmp_path), None, refiners, costs)
    parts = {"read maps", "refine correlative", "merge", "check", "draw", "draw and write"}
    assert parts <= set(_medians_ms(costs.cpu)) == set(_medians_ms(costs.wall))
    told = json.loads((tmp_path / "out" / "result.json").read_text())
    assert told["overlap"] > 0.5
