"""Write the published images as DOPE's training data: `X.png` and `X.json` side by side."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from rich.console import Console

from rendezvous.commands.export.dataset_images import ImageTable, LabelledImage, Split, published_splits
from rendezvous.commands.export.image_folder import (
    check_room,
    numbered,
    remove_file,
    write_file,
    written_images,
)
from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.cuboid import Vec3
from rendezvous.interop.dope_json import CM_PER_M, dope_json

CROP_PX = 400  # DOPE's loader cuts a square of this side out of every image


@dataclass(slots=True, kw_only=True)
class DopeExport:
    """What was written."""

    folder: Path
    images: int = 0  # number of images
    # Number of images that show each kind of robot; the kinds are DOPE's classes.
    seen: Counter[str] = field(default_factory=Counter)
    cuboids_m: dict[str, Vec3] = field(default_factory=dict)  # each kind's cuboid: sides along the axes of o
    camera: PinholeCamera | None = None  # camera of the first image

    def summary(self) -> str:
        """What was written, and the lines for DOPE's configuration."""
        assert self.camera is not None, "an export has images"
        seen = ", ".join(f"{self.seen[robot]} with {robot!r}" for robot in self.cuboids_m)
        sizes_cm = {
            robot: [round(CM_PER_M * side_m, 4) for side_m in size_m]
            for robot, size_m in self.cuboids_m.items()
        }
        camera = self.camera
        P = [camera.fx_px, 0.0, camera.cx_px, 0.0, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0]
        return "\n".join(
            [
                f"{self.images} images in {self.folder}, {seen}",
                f"train.py: --data {self.folder} --object {' '.join(self.cuboids_m)}",
                "config_pose.yaml:  # cm along x, y, z of the cuboid: the order that DOPE wants",
                f"  dimensions: {json.dumps(sizes_cm)}",
                f"  class_ids: {json.dumps({robot: i for i, robot in enumerate(self.cuboids_m, start=1)})}",
                "camera_info.yaml:",
                f"  image_width: {camera.width_px}",
                f"  image_height: {camera.height_px}",
                f"  projection_matrix: {{rows: 3, cols: 4, data: {P}}}",
            ]
        )


def export_dope(
    dataset: str, out: Path, *, table: ImageTable, split: Split, count: int, console: Console
) -> DopeExport:
    """Write a table's images and labels for DOPE.

    There is no `_camera_settings.json` or `_object_settings.json`: the official loader and evaluation do not
    read them.

    Args:
        dataset: folder of the published dataset, a local path or a URI.
        out: folder to write to.
        table: the table with the images.
        split: the split, or all, which share one numbering.
        count: maximum number of images of each split; the first ones are written.
        console: shows progress.

    Raises:
        StoreError: the dataset or its images are not there, or a file cannot be written.
        PipelineError: an image is too small for DOPE, or two robots of one name differ.
    """
    splits = published_splits(dataset, table, split)
    check_room(out, sum(min(count, part.rows) for part in splits))
    made = DopeExport(folder=out)
    for _, image in written_images(splits, count, partial(_write_pair, out), console=console):
        _tally(made, image)
    return made


def _write_pair(out: Path, number: int, image: LabelledImage) -> None:
    """Write the label after its image: DOPE reads the images that have labels."""
    camera, path = image.label.camera, out / numbered(number)
    if min(camera.width_px, camera.height_px) < CROP_PX:
        raise PipelineError(
            f"{image.name}: {camera.width_px}x{camera.height_px} px; DOPE's loader crops images to "
            f"{CROP_PX}x{CROP_PX}, so they must be at least that"
        )
    label_path = path.with_suffix(".json")
    remove_file(label_path)
    write_file(path.with_suffix(".png"), image.png())
    write_file(label_path, dope_json(image.label, class_name=image.robot))


def _tally(made: DopeExport, image: LabelledImage) -> None:
    """Count an image and check that its robot is the same as before."""
    size_m = image.label.cuboid_size_m
    if made.cuboids_m.setdefault(image.robot, size_m) != size_m:
        raise PipelineError(
            f"{image.name}: {image.robot!r} has a cuboid of {size_m} m and elsewhere of "
            f"{made.cuboids_m[image.robot]} m; one name must mean one robot"
        )
    made.camera = made.camera or image.label.camera
    made.images += 1
    made.seen[image.robot] += image.label.visible_px > 0
