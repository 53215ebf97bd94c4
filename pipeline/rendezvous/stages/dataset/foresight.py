"""Find out early what would stop the last stages of `dataset`."""

from __future__ import annotations

from rendezvous.engine.run import Run
from rendezvous.plan_schema import PLAN_COLUMNS, plan_of
from rendezvous.rendering.opengl.gl import check_libraries
from rendezvous.robot_file import load_robot_model
from rendezvous.splits import split_plans
from rendezvous.stages.dataset.photos import photo_folder


def check_pictures(run: Run) -> None:
    """Check that `render` has what it needs, if it has anything to do.

    Raises:
        ConfigError: the robot has no model, or there are no photos.
        SetupError: a system library is missing.
    """
    section = run.config.render
    if section.views or section.poses_per_plan:
        check_libraries()
        load_robot_model(run.config.explore.robot)
        photo_folder(section.backgrounds)


def check_splits(run: Run) -> None:
    """Check that no split would be empty if robots met on every floor plan.

    Raises:
        SplitError: one would.
        StoreError: `floorplans` has not finished, or its output is damaged.
    """
    section = run.config.pack
    plans = [plan_of(row) for row in run.read("floorplans").rows(columns=PLAN_COLUMNS)]
    split_plans(
        [plan.digest() for plan in plans],
        validation_fraction=section.validation_fraction,
        test_fraction=section.test_fraction,
    )
