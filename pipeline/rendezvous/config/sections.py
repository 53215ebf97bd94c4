"""The parameters of each stage: types and bounds. The values are in `stages.yaml`."""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from rendezvous.config.strict import Section
from rendezvous.errors import ConfigError
from rendezvous.exploration.records import EpisodeParameters
from rendezvous.floorplan.generate import GeneratorParameters
from rendezvous.floorplan.validate import FloorplanLimits
from rendezvous.recorded.mapped import LidarModel
from rendezvous.recorded.meetings import Stretches
from rendezvous.recorded.odometry import DrawnOdometry
from rendezvous.rendering.draws import PoseDraws
from rendezvous.slam.slam import SlamParameters
from rendezvous.store.records import dotted
from rendezvous.training.parameters import Budget, Optimisation, Sampling
from rendezvous.training.relative_pose.sampling import PoseSampling

PositiveInt = Annotated[int, Field(ge=1, le=10**9)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]  # a column of the dataset holds it in 64 bits


class StageSection(Section):
    """One stage's parameters: numbers, strings, lists, or frozen dataclasses of the rooms."""

    @classmethod
    def stage(cls) -> str:
        """The stage's name: `ExploreSection` is `explore`'s, `TrainPoseSection` is `train_pose`'s."""
        return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__.removesuffix("Section")).lower()

    def parameters(self, *, exclude: Collection[str] = ()) -> dict[str, Any]:
        """JSON values by full key, such as `explore.episodes_per_plan`.

        Args:
            exclude: keys below the section, such as `generate.count`, to leave out with all keys below them.
        """
        left_out = tuple(f"{self.stage()}.{key}." for key in exclude)
        values = dotted({self.stage(): self.model_dump(mode="json")})
        return {key: value for key, value in values.items() if not f"{key}.".startswith(left_out)}


class SplitSection(StageSection):
    """How a published dataset is split."""

    # validation_fraction, test_fraction: shares of all floor plans or buildings; the rest is for training.
    validation_fraction: Share
    test_fraction: Share

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        total = self.validation_fraction + self.test_fraction
        if round(total, 9) > 1.0:
            name = self.stage()
            raise ConfigError(
                f"{name}.validation_fraction and {name}.test_fraction: sum to {total:g}; must be at most 1"
            )
        return self


class Generated(Section):
    """Generated plans: how many, and from what they are drawn."""

    count: Annotated[int, Field(ge=0, le=10**9)]
    plans: GeneratorParameters


class FloorplansSection(StageSection):
    """Which floor plans there are."""

    sources: tuple[str, ...]  # HouseExpo JSON files, folders of them, or the dataset's `json.tar.gz`
    generate: Generated  # plans to generate, after those of the sources
    limits: FloorplanLimits  # of a usable plan
    robot: str  # a shipped robot or a robot file, which must be able to move about a usable plan
    plans_per_shard: PositiveInt  # candidates per shard


class MeshesSection(StageSection):
    """How floor plans become solids."""

    wall_height_m: Positive  # height of the walls
    robot: str  # a shipped robot or a robot file; the MJCF has two of them
    furniture_density: Annotated[float, Field(ge=0, le=3)]  # of the examples: 0 none, 1 moderate, 2 crowded
    plans_per_shard: PositiveInt  # at most; a shard never spans two of `floorplans`


class ExploreSection(StageSection):
    """How two robots explore a floor plan until they meet."""

    plans_per_shard: PositiveInt  # at most; a shard never spans two of `meshes`
    episodes_per_plan: PositiveInt  # each has its own starts and furniture
    robot: str  # a shipped robot or a robot file
    furniture_density: Annotated[float, Field(ge=0, le=3)]  # 0 none, 1 moderate, 2 crowded
    start_margin_m: Annotated[float, Field(ge=0)]  # least distance from a robot at its start to anything else
    start_distance_m: Positive  # least distance between the two starts
    # Names of lidars in `assets/lidars` or paths of lidar files, with weights; none: the robot's own.
    lidar: dict[str, Annotated[float, Field(ge=0)]]
    # Share of episodes in which the two robots find different furniture, and the bounds of the share of its
    # pieces that differ.
    changed_share: Share
    changed_furniture: tuple[Share, Share]
    episode: EpisodeParameters  # duration, recording, noise, exploration, SLAM

    @field_validator("lidar", mode="before")
    @classmethod
    def _name_alone(cls, lidar: Any) -> Any:
        """A name stands for itself with any weight, null for the robot's own lidar."""
        return {} if lidar is None else {lidar: 1.0} if isinstance(lidar, str) else lidar

    @model_validator(mode="after")
    def _check_draws(self) -> Self:
        if self.lidar and not sum(self.lidar.values()) > 0.0:
            raise ConfigError("explore.lidar: all weights are 0; one must be above")
        if len({Path(name).stem for name in self.lidar}) < len(self.lidar):
            raise ConfigError("explore.lidar: two lidars of one name; rows could not tell them apart")
        if self.changed_furniture[0] > self.changed_furniture[1]:
            raise ConfigError(
                f"explore.changed_furniture is {list(self.changed_furniture)}; must be two rising shares"
            )
        return self


class RenderSection(StageSection):
    """Which images are rendered, and how training images are drawn; the robots are those of `explore`."""

    plans_per_shard: PositiveInt  # at most; a shard never spans two of `explore` (in training: of `meshes`)
    views: bool  # whether to take the picture of each sighting
    poses_per_plan: Annotated[int, Field(ge=0, le=10**9)]  # training images in each plan
    poses_per_furnishing: PositiveInt  # consecutive training images with the same furniture
    furniture_density: Annotated[float, Field(ge=0, le=3)]  # in training: 0 none, 1 moderate, 2 crowded
    texture_variants: Annotated[int, Field(ge=1, le=16)]  # textures of each kind (wood, cloth, ...)
    # What colours the pictures: `pyrender` rasterises them; `cycles` traces paths of light, takes a hundred
    # times as long and needs the extra `pathtraced`. Labels are the same.
    engine: Literal["pyrender", "cycles"]
    cycles_samples: Annotated[int, Field(ge=1, le=4096)]  # paths of light through each pixel
    # Of the images; null for PNG, lossless and four times the size.
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None
    backgrounds: str | None  # folder of photos to use as backgrounds of `free` images; null for painted rooms
    draws: PoseDraws  # shares and ranges of random draws

    @property
    def cycles_samples_if_used(self) -> int | None:
        """`cycles_samples`; None if the engine takes none."""
        return self.cycles_samples if self.engine == "cycles" else None


class PackSection(SplitSection):
    """How the published dataset is split and sharded."""

    rows_per_file: PositiveInt  # a file is filled with whole floor plans until it has at least this many rows


class RecordedLog(Section):
    """One recorded log, and what is known of it."""

    path: str  # a CARMEN log or a ROS bag
    building: str | None = None  # where it was recorded; by default the log's name. Splits go by it
    reference: str | None = None  # the true path in TUM's format, with the log's stamps
    relations: str | None = None  # Kümmerle's relations: robots meet at their pairs of scans only
    poses: str = "auto"  # what the poses in a CARMEN log are: auto, odometry or reference
    range_max_m: Positive | None = None  # readings from here on are no echo; null: found out
    topic: str | None = None  # of the scans in a ROS bag; null: there is one
    # x, y, z [m], roll, pitch, yaw [rad] of a bag's lidar on the robot; null: from its transforms
    lidar_pose: tuple[float, float, float, float, float, float] | None = None

    def files(self) -> list[str]:
        """All files that are read, the log first."""
        return [self.path, *(name for name in (self.reference, self.relations) if name is not None)]


class ReplaySection(SplitSection):
    """How recorded logs become pairs: stretches of a log become two robots that meet."""

    logs: tuple[RecordedLog, ...]
    pairs_per_log: PositiveInt
    draws_per_pair: PositiveInt  # most meetings drawn for each pair that is wanted
    stretches: Stretches  # length of the robots' ways, and the distance at which they meet
    overlap: tuple[Share, Share]  # bounds of the maps' overlap; a meeting beyond them is left out
    least_explored_m2: Annotated[float, Field(ge=0)]  # area that each map must hold
    robot: str  # a shipped robot or a robot file: the camera that sees, and the cuboid that is seen
    odometry: DrawnOdometry  # noise of the odometry of logs that have none
    lidar: LidarModel  # what logs do not say of their lidars
    slam: SlamParameters  # its `extent_m` follows from the path


class TrainingSection(StageSection):
    """How a model is trained."""

    settings: dict[str, Any]  # fields of the model's config that differ from their defaults
    # minutes, samples: training ends at whichever comes first; one of them may be null.
    minutes: Positive | None
    samples: PositiveInt | None
    validations: PositiveInt  # number of measurements of the averaged weights, evenly over the budget
    checkpoint_every_s: Positive  # most work that a kill can lose
    optimisation: Optimisation  # batches, learning rate, precision

    def budget(self) -> Budget:
        """When training ends."""
        return Budget(samples=self.samples, duration_s=None if self.minutes is None else 60.0 * self.minutes)

    @field_validator("settings")
    @classmethod
    def _check_settings(cls, settings: dict[str, Any]) -> dict[str, Any]:
        try:
            json.dumps(settings, allow_nan=False)
        except ValueError as error:
            raise PydanticCustomError("finite", "must hold finite numbers, texts and lists") from error
        return settings

    @model_validator(mode="after")
    def _check_budget(self) -> Self:
        if self.minutes is None and self.samples is None:
            name = self.stage()
            raise ConfigError(
                f"{name}.minutes and {name}.samples are both null; one of them must end the training"
            )
        return self


class TrainSection(TrainingSection):
    """How the frame-error estimator is trained."""

    model: str  # `matcher`, or a row of the paper's Table I: `vit-reg-lie`, `cnn`, ...
    validation_pairs: PositiveInt  # pairs in each measurement
    sampling: Sampling  # how samples are drawn from pairs


class TrainPoseSection(TrainingSection):
    """How the relative-pose network is trained."""

    # A safetensors file to start from: a trained network's weights or, for `settings.features: vgg19`,
    # VGG-19's under torchvision's names, such as `features.0.weight`; null for random weights.
    initial_weights: str | None
    more_data: tuple[str, ...]  # data folders whose training images are added to those of `--data`
    validation_images: PositiveInt  # images in each measurement
    sampling: PoseSampling  # how samples are drawn from images


class Parameters(Section):
    """The root seed and all stages' sections in flow order."""

    seed: Seed
    floorplans: FloorplansSection
    meshes: MeshesSection
    explore: ExploreSection
    render: RenderSection
    pack: PackSection
    replay: ReplaySection
    train: TrainSection
    train_pose: TrainPoseSection
