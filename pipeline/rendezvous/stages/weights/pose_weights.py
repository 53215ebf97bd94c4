"""Load the relative-pose network as an estimator."""

from __future__ import annotations

import numpy as np
import torch

from rendezvous.errors import ConfigError
from rendezvous.models.relative_pose_estimator import CloseLook, RelativePoseEstimator
from rendezvous.models.relative_pose_network import RelativePoseConfig, RelativePoseNet
from rendezvous.pose_estimation.observation_model import SeenRobot
from rendezvous.pose_estimation.pose_calibration import PoseCalibration
from rendezvous.training.checkpoint import fit_weights_in_place, read_checkpoint
from rendezvous.training.relative_pose.model import POSE_MODEL, PoseModel


def load_relative_pose(data: bytes, *, where: str) -> RelativePoseEstimator:
    """The estimator with these weights.

    Raises:
        StoreError: the file is damaged.
        ConfigError: the weights are of another model, or their record is incomplete.
    """
    found = read_checkpoint(data, where=where)
    record = found.record
    if record.get("model") != POSE_MODEL:
        raise ConfigError(f"{where}: weights of {record.get('model')!r}; must be those of {POSE_MODEL!r}")
    try:
        network = RelativePoseConfig.from_dict(record["network"])
        sampling, robot = record["sampling"], record["robot"]
        look = CloseLook(
            input_px=int(sampling["input_px"]),
            span_px=float(sampling["close_span_px"]),
            sigma_cells=float(sampling["belief_sigma_cells"]),
        )
        x_m, y_m, z_m = (float(side) for side in robot["size_m"])
        T_r1_o = np.array(robot["T_r1_o"], np.float64).reshape(4, 4)
    except (ConfigError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{where}: its record of the training has a wrong or missing entry ({error}); train anew"
        ) from error
    model = PoseModel(RelativePoseNet(network))
    fit_weights_in_place(model, found.under("average.") or found.tensors, where=where)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return RelativePoseEstimator(
        network=model.network.to(device).eval(),
        robot=SeenRobot(size_m=(x_m, y_m, z_m), T_r1_o=T_r1_o),
        close=look,
        calibration=PoseCalibration.from_dict(record.get("calibration", PoseCalibration().as_dict())),
    )
