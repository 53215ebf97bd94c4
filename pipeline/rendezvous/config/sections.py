"""The parameters of each stage: their types, what bounds them, which stages each one reads."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from rendezvous.config.strict_section import Section
from rendezvous.errors import ConfigError
from rendezvous.exploration.records import EpisodeParameters
from rendezvous.floorplan.generate import GeneratorParameters
from rendezvous.floorplan.validate import FloorplanLimits
from rendezvous.rendering.draws import PoseDraws
from rendezvous.store.records import dotted
from rendezvous.training.parameters import Optimisation, Sampling
from rendezvous.training.relative_pose.sampling import PoseSampling

PositiveInt = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]  # a column of the dataset holds it in 64 bits


class StageSection(Section):
    """One stage's parameters.

    Fields are numbers, strings, lists, or frozen dataclasses of the rooms; what bounds a value is written
    in its type. `stages.yaml` holds the values.
    """

    @classmethod
    def stage(cls) -> str:
        """The stage's name: `ExploreSection` is `explore`'s, `TrainPoseSection` is `train_pose`'s."""
        return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", cls.__name__.removesuffix("Section")).lower()

    def parameters(self, *, exclude: Collection[str] = ()) -> dict[str, Any]:
        """Values as JSON holds them, by their full key, e.g. `explore.max_range_m`.

        Args:
            exclude: keys below the section, such as `generate.count`, on which a shard does not depend;
                a key leaves out all that is below it.
        """
        left_out = tuple(f"{self.stage()}.{key}." for key in exclude)
        values = dotted({self.stage(): self.model_dump(mode="json")})
        return {key: value for key, value in values.items() if not f"{key}.".startswith(left_out)}


class Generated(Section):
    """Plans that are generated: how many, and what they are drawn from."""

    count: Annotated[int, Field(ge=0)]
    plans: GeneratorParameters


class FloorplansSection(StageSection):
    """Which floor plans there are.

    Attributes:
        sources: HouseExpo JSON files, folders of them, or the dataset's `json.tar.gz`.
        generate: plans made here, after those of the sources.
        limits: what a usable plan keeps to.
        robot: a shipped robot or a robot file; a usable plan lets it get around.
        plans_per_shard: candidates per shard.
    """

    sources: tuple[str, ...]
    generate: Generated
    limits: FloorplanLimits
    robot: str
    plans_per_shard: PositiveInt


class MeshesSection(StageSection):
    """How floor plans become solids.

    Attributes:
        wall_height_m: height of the walls.
        robot: a shipped robot or a robot file; two of it stand in the MJCF.
        furniture_density: of the example furniture: 0 none, 1 moderate, 2 crowded.
        plans_per_shard: at most as many as a shard of `floorplans` has.
    """

    wall_height_m: Positive
    robot: str
    furniture_density: Annotated[float, Field(ge=0, le=3)]
    plans_per_shard: PositiveInt


class ExploreSection(StageSection):
    """How two robots explore a floor plan until they meet.

    Attributes:
        plans_per_shard: at most as many as a shard of `meshes` has.
        episodes_per_plan: explorations of each plan, each with its own starts and furniture.
        robot: a name in `assets/robots`, or the path of a robot file.
        furniture_density: 0 none, 1 moderate, 2 crowded.
        start_margin_m: from a robot at its start to everything else.
        start_distance_m: between the two starts.
        episode: how long an episode runs, what is recorded, noise, exploration, SLAM.
    """

    plans_per_shard: PositiveInt
    episodes_per_plan: PositiveInt
    robot: str
    furniture_density: Annotated[float, Field(ge=0, le=3)]
    start_margin_m: Annotated[float, Field(ge=0)]
    start_distance_m: Positive
    episode: EpisodeParameters


class RenderSection(StageSection):
    """What is rendered, and how training images are drawn; the robots are those of `explore`.

    Attributes:
        plans_per_shard: at most as many as a shard of `explore` (of `meshes` for training images) has.
        views: whether to take the picture of each sighting.
        poses_per_plan: training images in each plan.
        poses_per_furnishing: of them, how many in a row see the rooms furnished alike.
        furniture_density: of training images: 0 none, 1 moderate, 2 crowded.
        texture_variants: textures of each kind (wood, cloth, ...) to choose from.
        jpeg_quality: of the images; null for PNG, lossless and four times the size.
        backgrounds: a folder of one's own photos to stand behind `free` images; null for painted rooms.
        draws: shares and ranges of what is drawn at random.
    """

    plans_per_shard: PositiveInt
    views: bool
    poses_per_plan: Annotated[int, Field(ge=0)]
    poses_per_furnishing: PositiveInt
    furniture_density: Annotated[float, Field(ge=0, le=3)]
    texture_variants: Annotated[int, Field(ge=1, le=16)]
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None
    backgrounds: str | None
    draws: PoseDraws


class PackSection(StageSection):
    """How sightings become the published dataset.

    Attributes:
        rows_per_file: a file takes whole floor plans until it holds this many rows.
        validation_fraction, test_fraction: shares of all floor plans, together at most 1; the rest is for
            training.
    """

    rows_per_file: PositiveInt
    validation_fraction: Share
    test_fraction: Share

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        total = self.validation_fraction + self.test_fraction
        if round(total, 9) > 1.0:
            raise ConfigError(
                f"pack.validation_fraction and pack.test_fraction: sum to {total:g}; must be at most 1"
            )
        return self


class TrainingSection(StageSection):
    """How weights are found, whatever the model.

    Attributes:
        settings: of the model's own configuration, those that are not to be the default.
        minutes, samples: when training ends, whichever comes first; null for no such bound, but not both.
        validations: how often the averaged weights are measured, evenly over the budget.
        checkpoint_every_s: how much a kill may cost.
        optimisation: batches, learning rate, precision.
    """

    settings: dict[str, Any]
    minutes: Positive | None
    samples: PositiveInt | None
    validations: PositiveInt
    checkpoint_every_s: Positive
    optimisation: Optimisation

    @model_validator(mode="after")
    def _check_budget(self) -> Self:
        if self.minutes is None and self.samples is None:
            name = self.stage()
            raise ConfigError(
                f"{name}.minutes and {name}.samples are both null; one of them must end the training"
            )
        return self


class TrainSection(TrainingSection):
    """How the frame-error estimator is trained.

    Attributes:
        model: `matcher`, or a row of the paper's Table I: `vit-reg-lie`, `cnn`, ...
        validation_pairs: with how many pairs the averaged weights are measured.
        sampling: what is drawn from each pair.
    """

    model: str
    validation_pairs: PositiveInt
    sampling: Sampling


class TrainPoseSection(TrainingSection):
    """How the relative-pose network is trained.

    Attributes:
        initial_features: with `settings.features: vgg19`: a safetensors file of VGG-19's weights by
            torchvision's names, such as `features.0.weight`; null to begin with random ones.
        validation_images: with how many images the averaged weights are measured.
        sampling: what is drawn from each image.
    """

    initial_features: str | None
    validation_images: PositiveInt
    sampling: PoseSampling


class Parameters(Section):
    """The root seed and the sections of all stages, in flow order."""

    seed: Seed
    floorplans: FloorplansSection
    meshes: MeshesSection
    explore: ExploreSection
    render: RenderSection
    pack: PackSection
    train: TrainSection
    train_pose: TrainPoseSection
