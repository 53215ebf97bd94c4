"""Train the relative-pose network on the published images of the robot, in one process or several."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import safetensors
import safetensors.torch
from torch import Tensor

from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError, StoreError
from rendezvous.stages.training.calibrate_pose import LEAST_ROWS, calibrate_pose
from rendezvous.stages.training.train_record import WEIGHTS
from rendezvous.stages.training.training_run import joined_processes, train_in_folder
from rendezvous.store.disk import Disk
from rendezvous.training.checkpoint import read_checkpoint
from rendezvous.training.relative_pose.data import PoseTrainingBatches, validation_samples
from rendezvous.training.relative_pose.model import POSE_MODEL, build_pose_model, is_trained
from rendezvous.training.relative_pose.poses import KIND, read_poses
from rendezvous.training.relative_pose.validation import PoseValidation


def train_pose(run: Run, *, out: Path | None = None, resume: bool = False) -> Path:
    """Train the network until its budget is spent; fit its confidence to the validation images then.

    Returns the folder.

    Args:
        run: the `train_pose` section, where the data lies, and how many cores to use.
        out: folder for checkpoint, weights, curve and TensorBoard's events; `runs/relative-pose` by default.
        resume: go on from the folder's checkpoint, if there is one.

    Raises:
        ConfigError: a setting is wrong, or is not what the checkpoint was begun with.
        StoreError: the dataset or the checkpoint is missing or damaged, or the folder holds another run.
    """
    section, reader, seed = run.config.train_pose, run.read("pack"), run.config.seed
    where = section.initial_weights
    initial, seen_before = (None, []) if where is None else _weights(where)
    with joined_processes(run.workers) as processes:
        model = build_pose_model(section.settings, seed=seed, initial_weights=initial, where=where or "")
        more = [replace(run, data=folder).read("pack") for folder in section.more_data]
        training = read_poses(reader, "train", more=more)
        validation = read_poses(reader, "validation")
        samples = validation_samples(validation, section.sampling, seed=seed, count=section.validation_images)
        folder = train_in_folder(
            run,
            section,
            model,
            {"train": training, "validation": validation},
            partial(PoseTrainingBatches, training, section.sampling),
            PoseValidation(samples=samples, sampling=section.sampling, device=processes.device),
            name=POSE_MODEL,
            rows=KIND,
            out=out,
            resume=resume,
            processes=processes,
            seen_before=seen_before,
            robot=asdict(training.robot()),
            sampling=asdict(section.sampling),
        )
    if processes.first:
        _calibrate(run, len(validation), folder)
    return folder


def _calibrate(run: Run, validation_rows: int, folder: Path) -> None:
    """Fit the confidence where enough robots are found; a short run need not get there.

    Nor need all images be such as a robot takes: what is trained is kept without a calibration then.
    """
    if validation_rows < LEAST_ROWS:
        run.say(f"calibrate: left out, {validation_rows} validation images; it takes {LEAST_ROWS}")
        return
    weights, dataset = folder / WEIGHTS, run.folder("pack")
    try:
        calibrate_pose(weights, dataset, seed=run.config.seed, threads=run.workers, console=run.console)
    except (ConfigError, StoreError) as error:
        run.say(f"calibrate: left out, {error}")


def _weights(path: str) -> tuple[dict[str, Tensor], list[str]]:
    """Weights to start from, and digests of the floor plans that they were trained on."""
    try:
        data = Disk(str(Path(path).parent)).read(Path(path).name)
        tensors = safetensors.torch.load(data)
    except (StoreError, OSError, safetensors.SafetensorError) as error:
        raise ConfigError(
            f"train_pose.initial_weights is {path}: {' '.join(str(error).split())}; must be a safetensors "
            "file: a trained network's weights, or torchvision's vgg19 (features.0.weight, ...)"
        ) from error
    if not is_trained(tensors):
        return tensors, []
    return tensors, list(read_checkpoint(data, where=path).record.get("data", {}).get("plan_digests") or [])
