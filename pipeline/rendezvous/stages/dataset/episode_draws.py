"""What is drawn for an episode besides furniture and starts: its robots' lidars, and changes of its scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rendezvous.config.sections import ExploreSection
from rendezvous.floorplan.changes import changed_furniture
from rendezvous.floorplan.furnish import arranged
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.seeds import stream
from rendezvous.simulation.robot import RobotSpec

_SAME_LIDAR = 0.5  # share of episodes whose robots carry the same lidar, as those of one fleet do

Names = tuple[str | None, str | None]


def draw_lidars(weights: Mapping[str, float], *, rng: np.random.Generator) -> Names:
    """The name of each robot's lidar; None for the robot's own."""
    if not weights:
        return None, None
    names, p = list(weights), np.array(list(weights.values()))
    # Categorical; in every other episode drawn once for both robots, else for each.
    first, second = (names[i] for i in rng.choice(len(names), size=2, p=p / p.sum()))
    return first, first if rng.random() < _SAME_LIDAR else second


def draw_change(section: ExploreSection, *, rng: np.random.Generator) -> float | None:
    """The share of the furniture that differs between the robots' worlds; None if they are one."""
    # Bernoulli, then uniform.
    changes, share = rng.random() < section.changed_share, rng.uniform(*section.changed_furniture)
    return float(share) if changes else None


def changed_after(
    plan: Floorplan,
    section: ExploreSection,
    robot: RobotSpec,
    seed: int,
    key: tuple[str | int, ...],
    share: float,
) -> tuple[Solid, ...]:
    """The furniture of the episode with this key, as the second robot finds it."""
    pieces = arranged(
        plan,
        stream(seed, *key, "furniture"),
        density=section.furniture_density,
        robot_radius_m=robot.radius_m,
    )
    rng = stream(seed, *key, "changed furniture")
    return changed_furniture(plan, pieces, rng, share=share, robot_radius_m=robot.radius_m)


def lidar_label(name: str) -> str:
    """How rows name a lidar: a file of the user's by its name alone, wherever it lies."""
    return Path(name).stem if name.endswith((".yaml", ".yml")) else name


def in_words(lidars: Names, changed: float | None) -> str:
    """What was drawn, as `episode_id` has it; '' for nothing."""
    words = []
    if lidars != (None, None):
        words.append(f" lidars={','.join(lidar_label(str(name)) for name in lidars)}")
    if changed is not None:
        words.append(f" changed={changed:.2f}")
    return "".join(words)
