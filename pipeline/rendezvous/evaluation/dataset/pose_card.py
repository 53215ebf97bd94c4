"""What the dataset's card says about images: those of the sightings, and the training images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.evaluation.dataset.quantiles import quantile_table
from rendezvous.evaluation.dataset.tables import markdown_table
from rendezvous.geometry.se2 import Array
from rendezvous.splits import SPLITS

VIEW_COLUMNS = ("pair_id", "plan_id", "visibility")
"""What the card's section on the sightings' images is computed from, beside the sightings themselves."""

POSE_COLUMNS = ("seed", "plan_id", "plan_digest", "mode", "visibility", "T_c_o")
"""What the card's section on training images is computed from."""

_SIGHTED = 0.5


def views_section(sightings: pa.Table) -> str:
    """How many sightings have an image, and how much of the robot is visible there.

    Args:
        sightings: `visible_fraction` of all rows and `visibility`, null where there is no image.
    """
    seen = sightings.filter(pc.field("visibility").is_valid())
    title = "## Images of the sightings"
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
    absent = poses["T_c_o"].null_count / poses.num_rows
    return (
        "## Poses\n\nEvery row of `poses` is a training image for a pose estimator such as DOPE, with one "
        "robot or none: in `plausible` ones on the floor of a furnished room, seen by another's camera, "
        "in `free` ones anywhere before any background. All that was drawn at random for an image is in its "
        "column `drawn`.\n\n"
        "![Some of the images with their labels, from hidden to fully visible](poses.png)\n\n"
        f"{_split_table(poses)}\n\nA floor plan's poses are in the split that its pairs are in. The robot is "
        f"absent from {absent:.1%} of the images. Quantiles where it is present:\n\n"
        f"{pose_quality_table(poses)}"
    )


def pose_quality_table(poses: pa.Table) -> str:
    """Quantiles of visibility and distance over the images with a robot."""
    present = poses.filter(pc.field("T_c_o").is_valid())
    visibility = present["visibility"].to_numpy()
    return quantile_table([("Visibility", visibility, 2), ("Distance [m]", _distances_m(present), 2)])


def _distances_m(present: pa.Table) -> Array:
    """(N,) from the camera to the centre of the robot's cuboid."""
    T_c_o = np.array(present["T_c_o"].to_pylist()).reshape(-1, 4, 4)
    return np.asarray(np.linalg.norm(T_c_o[:, :3, 3], axis=1))


def _split_table(poses: pa.Table) -> str:
    modes = sorted(poses["mode"].unique().to_pylist(), reverse=True)
    rows = []
    for split in SPLITS:
        part = poses.filter(pc.field("split") == split)
        if part.num_rows:
            of_mode = [part.filter(pc.field("mode") == mode).num_rows for mode in modes]
            rows.append((split, len(part["plan_digest"].unique()), *of_mode, part.num_rows))
    totals = ("all", *(sum(row[i] for row in rows) for i in range(1, len(modes) + 3)))
    return markdown_table(("split", "floor plans", *modes, "poses"), [*rows, totals])


def licence_note(parameters: Mapping[str, Any]) -> str:
    """What the images are made of.

    Args:
        parameters: all that the rows depend on, by dotted key.
    """
    photos = any(value for key, value in parameters.items() if f"{key}.".startswith("render.backgrounds."))
    note = (
        "Textures, painted rooms, furniture and the shipped robot's model are made by this project's own "
        "code; nothing in the images is downloaded"
    )
    if photos:
        return (
            f"{note}. Behind some `free` images stand photos from the user's folder that "
            "`render.backgrounds` named: their licence is for the user to say."
        )
    return f"{note}, and no photo is in them."
