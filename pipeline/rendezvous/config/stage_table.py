"""The stages in flow order. A new stage is named here; commands, configuration, card and docs follow.

Imports nothing, so that the command line can list the stages at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One stage."""

    name: str  # its function, its module in `rendezvous.stages`, its section of `stages.yaml`
    reads: tuple[str, ...] = ()  # the stages whose output it reads
    about: str  # what it does, in one sentence
    # It writes to the working folder, because its output outlives the data. Several stages may share a folder
    # there, with a folder for each run inside.
    beside_data: bool = False
    # It publishes a dataset of its own, in a data folder of its own: no part of `rendezvous dataset`.
    apart: bool = False


_IN_FLOW_ORDER: Sequence[Stage] = (
    Stage(name="floorplans", about="Read and generate floor plans; keep those that two robots can explore."),
    Stage(
        name="meshes",
        reads=("floorplans",),
        about="Raise walls and furniture from floor plans: boxes for physics and rays, GLB and MJCF.",
    ),
    Stage(
        name="explore",
        reads=("meshes",),
        about="Drive two robots through each plan until they meet; write one row per sighting.",
    ),
    Stage(
        name="render",
        reads=("meshes", "explore"),
        about="Take the picture of each sighting, and training images of the robot, with DOPE's labels.",
    ),
    Stage(
        name="pack",
        reads=("explore", "render"),
        about="Publish sightings and images as a dataset, split by floor plan and described by a card.",
    ),
    Stage(
        name="replay",
        apart=True,
        about="Make pairs out of recorded laser logs of real robots and publish them on their own.",
    ),
    Stage(
        name="train",
        reads=("pack",),
        beside_data=True,
        about="Train the frame-error estimator on the published pairs.",
    ),
    Stage(
        name="train_pose",
        reads=("pack",),
        beside_data=True,
        about="Train the relative-pose network on the published images of the robot.",
    ),
)

STAGES = {stage.name: stage for stage in _IN_FLOW_ORDER}
DATASET_STAGES = tuple(name for name, stage in STAGES.items() if not (stage.beside_data or stage.apart))
"""The stages that `rendezvous dataset` runs."""
