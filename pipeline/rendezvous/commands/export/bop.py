"""Write the published images as a dataset in the BOP format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console

from rendezvous.commands.export.dataset_images import (
    ImageTable,
    LabelledImage,
    PublishedSplit,
    Split,
    published_splits,
)
from rendezvous.commands.export.image_folder import (
    check_room,
    numbered,
    remove_file,
    write_file,
    written_images,
)
from rendezvous.errors import ConfigError, PipelineError
from rendezvous.geometry.se2 import Array
from rendezvous.interop.bop import (
    bop_json,
    camera_document,
    model_ply,
    model_vertices,
    models_info_document,
    scene_camera_document,
    scene_gt_document,
    scene_gt_info_document,
    targets_document,
)
from rendezvous.interop.pose_label import PoseLabel
from rendezvous.rendering.robot_model import check_inside_cuboid, robot_parts
from rendezvous.robot_file import load_robot, load_robot_model

OBJ_ID, SCENE_ID = 1, 0

_SPLIT_FOLDERS = {"train": "train", "validation": "val", "test": "test"}
_LARGEST_DIFFERENCE_M = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class BopExport:
    """What was written."""

    folder: Path
    robot: str  # name of object 1
    images: Mapping[str, int]  # number of images by BOP's name of the split
    seen: int  # number of images that show the robot
    left_out: int  # number of images without a box because part of the robot is behind the camera
    targets: int  # number of targets in the test split

    def summary(self) -> str:
        """What was written, in one line."""
        folders = ", ".join(f"{images} in {split}/" for split, images in self.images.items())
        left_out = f"; {self.left_out} left out: a part of the robot is behind the camera"
        return (
            f"{sum(self.images.values())} images in {self.folder} ({folders}), {self.seen} of which show "
            f"{self.robot!r}, object {OBJ_ID}; {self.targets} test targets{left_out * bool(self.left_out)}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    """The robot in the dataset."""

    robot: str
    T_r1_o: Array
    cuboid_size_m: tuple[float, float, float]
    parts: Mapping[str, trimesh.Trimesh]


def export_bop(
    dataset: str,
    out: Path,
    *,
    table: ImageTable,
    split: Split,
    robot: str | None,
    count: int,
    console: Console,
) -> BopExport:
    """Write a table's images and labels, and the robot's model, in the BOP format.

    BOP calls the validation split `val`. There are no depth images or masks: the dataset has none.

    Args:
        dataset: folder of the published dataset, a local path or a URI.
        out: folder to write to.
        table: the table with the images.
        split: the split, or all.
        robot: a shipped robot or a robot file; the dataset's robot by default.
        count: maximum number of images of each split; the first ones are written.
        console: shows progress.

    Raises:
        StoreError: the dataset or its images are not there, or a file cannot be written.
        ConfigError: there is no such robot, or it is not the one that the dataset shows.
    """
    splits = published_splits(dataset, table, split)
    for part in splits:
        check_room(_scene(out, part) / "rgb", min(count, part.rows))
    first = next(splits[0].images())
    model = _model(first, robot)
    _write_model(out, model)
    write_file(out / "camera.json", bop_json(camera_document(first.label.camera)))
    labels = {
        _SPLIT_FOLDERS[part.split]: _write_scene(_scene(out, part), part, count, model, console)
        for part in splits
    }
    targets = targets_document(labels.get("test", {}), obj_id=OBJ_ID, scene_id=SCENE_ID)
    if "test" in labels:
        write_file(out / "test_targets_bop19.json", bop_json(targets))
    return BopExport(
        folder=out,
        robot=model.robot,
        images={name: len(of_split) for name, of_split in labels.items()},
        seen=sum(label.visible_px > 0 for of_split in labels.values() for label in of_split.values()),
        left_out=sum(min(count, part.rows) for part in splits) - sum(map(len, labels.values())),
        targets=len(targets),
    )


def _scene(out: Path, part: PublishedSplit) -> Path:
    return out / _SPLIT_FOLDERS[part.split] / numbered(SCENE_ID)


def _model(image: LabelledImage, robot: str | None) -> _Model:
    """Model of the robot in an image, from the robot's files."""
    try:
        spec = load_robot(robot or image.robot)
    except ConfigError as error:
        if robot is not None:
            raise
        raise ConfigError(f"{error}; --robot PATH names the robot file of the {image.robot!r}") from error
    size_m = image.label.cuboid_size_m
    differences_m = np.append(np.subtract(spec.cuboid.size_m, size_m), spec.cuboid.T_r_o() - image.T_r1_o)
    if np.abs(differences_m).max() > _LARGEST_DIFFERENCE_M:
        raise ConfigError(
            f"robot {robot or image.robot!r}: a cuboid of {spec.cuboid.size_m} m around "
            f"{spec.cuboid.centre_m} m; the dataset's is of {size_m} m around "
            f"{tuple(image.T_r1_o[:3, 3].tolist())} m, so --robot must name another robot file"
        )
    parts = robot_parts(load_robot_model(robot or image.robot), source=f"model of {robot or image.robot}")
    check_inside_cuboid(parts, spec.cuboid, robot=spec.name)
    return _Model(robot=image.robot, T_r1_o=image.T_r1_o, cuboid_size_m=size_m, parts=parts)


def _write_model(out: Path, model: _Model) -> None:
    vertices = model_vertices(model.parts, model.T_r1_o)
    write_file(out / "models" / f"obj_{OBJ_ID:06d}.ply", model_ply(model.parts, model.T_r1_o))
    write_file(out / "models" / "models_info.json", bop_json(models_info_document({OBJ_ID: vertices})))


def _write_scene(
    scene: Path, part: PublishedSplit, count: int, model: _Model, console: Console
) -> dict[int, PoseLabel]:
    """Write one split's images, then the documents, which must never lie beside another export's images."""
    names = ("scene_camera.json", "scene_gt.json", "scene_gt_info.json")
    for name in names:
        remove_file(scene / name)
    written = written_images(
        [part], count, partial(_write_image, scene / "rgb", model), console=console, keep=_in_front
    )
    labels = {number: image.label for number, image in written}
    documents = (
        scene_camera_document(labels),
        scene_gt_document(labels, obj_id=OBJ_ID),
        scene_gt_info_document(labels, model_vertices(model.parts, model.T_r1_o)),
    )
    for name, document in zip(names, documents, strict=True):
        write_file(scene / name, bop_json(document))
    return labels


def _in_front(image: LabelledImage) -> bool:
    """Whether the whole robot is in front of the camera; otherwise its silhouette has no box."""
    uv_px = image.label.projected_cuboid_px()
    return uv_px is None or bool(np.isfinite(uv_px).all())


def _write_image(folder: Path, model: _Model, number: int, image: LabelledImage) -> None:
    if (image.robot, image.label.cuboid_size_m) != (model.robot, model.cuboid_size_m):
        raise PipelineError(
            f"{image.name}: shows {image.robot!r} with a cuboid of {image.label.cuboid_size_m} m, the first "
            f"image {model.robot!r} with {model.cuboid_size_m} m; all must show one robot"
        )
    write_file(folder / f"{numbered(number)}.png", image.png())
