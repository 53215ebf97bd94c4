"""The dataset card's sections on images: those of the sightings, and those to train on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.evaluation.dataset.tables import distinct, quantile_table, split_table

VIEW_COLUMNS = ("pair_id", "plan_id", "visibility")
"""Columns of `VIEWS` that the section on the sightings' images needs."""

POSE_COLUMNS = ("seed", "plan_id", "plan_digest", "mode", "visibility", "T_c_o")
"""Columns of `POSES` that the section on training images needs."""

_SIGHTED = 0.5


def views_section(sightings: pa.Table) -> str:
    """How many sightings have an image, and how much of the robot it shows.

    Args:
        sightings: `visible_fraction` of all rows, and `visibility`, which is null where there is no image.
    """
    title = "## Images of the sightings"
    seen = sightings.filter(pc.field("visibility").is_valid())
    if not seen.num_rows:
        return (
            f"{title}\n\nNo sighting has an image: `render.views` was off. "
            "`image` and the columns of its label are null."
        )
    visibility, fraction = seen["visibility"].to_numpy(), seen["visible_fraction"].to_numpy()
    return (
        f"{title}\n\n{seen.num_rows} of {sightings.num_rows} sightings have an image, what the camera of "
        "robot 0 saw in the furnished plan, and a label of robot 1 in it.\n\n"
        f"{quantile_table([('Visibility', visibility, 2)])}\n\n"
        "A sighting is one where at least half of the sample points of robot 1's cuboid are in the image and "
        f"unobstructed. In {np.mean(visibility >= _SIGHTED):.1%} of the images the `visibility` that was "
        "rendered is at least one half as well. `visible_fraction` and `visibility` differ by "
        f"{np.mean(np.abs(fraction - visibility)):.3f} on average (mean absolute difference)."
    )


def poses_section(poses: pa.Table) -> str:
    """How many training images there are, and what they show.

    Args:
        poses: `POSE_COLUMNS` of all rows and their `split`.
    """
    modes = sorted(poses["mode"].unique().to_pylist(), reverse=True)
    of_mode = {mode: lambda rows, m=mode: len(rows.filter(pc.field("mode") == m)) for mode in modes}
    counts = {"floor plans": distinct("plan_digest"), **of_mode, "poses": len}
    return (
        "## Poses\n\nEvery row of `poses` is a training image for a pose estimator such as DOPE, with one "
        "robot or none: in `plausible` ones on the floor of a furnished room, seen by another's camera, "
        "in `free` ones anywhere before any background. All that was drawn at random for an image is in its "
        "column `drawn`.\n\n"
        "![Some of the images with their labels, from hidden to fully visible](poses.png)\n\n"
        f"{split_table(poses, counts)}\n\nA floor plan's poses are in the split that its pairs are in. The "
        f"robot is absent from {poses['T_c_o'].null_count / poses.num_rows:.1%} of the images. Quantiles "
        f"where it is present:\n\n{pose_quality_table(poses)}"
    )


def pose_quality_table(poses: pa.Table) -> str:
    """Quantiles of visibility and distance over the images with a robot."""
    present = poses.filter(pc.field("T_c_o").is_valid())
    T_c_o = np.array(present["T_c_o"].to_pylist()).reshape(-1, 4, 4)
    distance_m = np.linalg.norm(T_c_o[:, :3, 3], axis=1)
    return quantile_table(
        [("Visibility", present["visibility"].to_numpy(), 2), ("Distance [m]", distance_m, 2)]
    )


def licence_note(parameters: Mapping[str, Any]) -> str:
    """What the images are made of, and under which licence.

    Args:
        parameters: all that the rows depend on, by dotted key.
    """
    note = (
        "Textures, painted rooms, furniture and the shipped robot's model are made by this project's own "
        "code; nothing in the images is downloaded"
    )
    if any(value for key, value in parameters.items() if f"{key}.".startswith("render.backgrounds.")):
        return (
            f"{note}. Behind some `free` images stand photos from the user's folder that "
            "`render.backgrounds` named: their licence is for the user to say."
        )
    return f"{note}, and no photo is in them."
