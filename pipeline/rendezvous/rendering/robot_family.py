"""A robot as others of its make may look: built otherwise, repainted, carrying more or less, worn.

A variant moves, scales, repaints and leaves out parts of the robot's model. What may happen to a part follows
from its kind, the first word of its name (`plate.2`, `post.0.front_left`, `lidar.lds01.head`); a part of
another kind is only repainted and worn. The label stays that of the robot file: the cuboid of the robot as
designed, wherever a variant's outermost parts are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.appearance.textures import texture_key
from rendezvous.rendering.draws import RobotDraws
from rendezvous.rendering.plan_scene import BOX, CYLINDER
from rendezvous.rendering.record import JsonValue, plain
from rendezvous.rendering.robot_model import model_of, nominal_parts, part_material
from rendezvous.rendering.scene import Instance, Material, MeshPool, Rgb
from rendezvous.simulation.robot import RobotSpec

ROBOT = "r1"
"""Name of the labelled robot in scenes."""

CONTENTS = ("battery", "board", "bracket", "chip", "plug", "sticker")
"""Kinds of parts that stand on a plate: they move with it, and a layer's together."""

OPTIONAL = ("bracket", "cable", "chip", "plug", "screw", "sticker")
FIXED = ("caster", "motor", "rim", "tyre")
"""Kinds that hold the robot up: they stay where the robot file has them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part as built: its own material and `bounds_m` (2, 3), its lowest and highest coordinates in r."""

    material: Material
    bounds_m: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class WornPart:
    """A part of a variant: a mesh of the pool, its (4, 4) place in r, which may scale it, and material."""

    mesh: str
    T_r: Array
    material: Material


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One robot of the family: its parts by name, and what was drawn for it, as plain JSON."""

    parts: Mapping[str, WornPart]
    record: Mapping[str, JsonValue]

    def instances(self, T_w_r1: Array) -> tuple[Instance, ...]:
        """Its parts at a pose (4, 4)."""
        return tuple(
            Instance(name=f"{ROBOT}/{name}", mesh=part.mesh, T_w=T_w_r1 @ part.T_r, material=part.material)
            for name, part in self.parts.items()
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotLooks:
    """The labelled robot: its dimensions and its parts as built, by name; meshes are in r."""

    spec: RobotSpec
    parts: Mapping[str, Part]

    def as_built(self) -> Variant:
        """The robot of the model, with the first model of each device."""
        return self._variant({name: np.eye(4) for name in nominal_parts(self.parts)}, {}, {"as_built": True})

    def draw(self, rng: np.random.Generator, draws: RobotDraws, *, wear: float, variants: int) -> Variant:
        """A robot of the family.

        Args:
            rng: draws everything.
            draws: shares and ranges.
            wear: at 1, brightness stays within about 40 % of what it is as built, hue within 15 %.
            variants: number of textures of each kind in the pool.
        """
        if rng.random() < draws.as_built_share:
            chosen, record = nominal_parts(self.parts), dict[str, JsonValue](as_built=True)
            placed = {name: np.eye(4) for name in chosen}
        else:
            placed, record = self._rebuilt(rng, draws)
        paints = self._paints(rng, draws, placed, wear=wear, variants=variants)
        record["paints"] = plain(paints)
        variant = self._variant(placed, paints, record)
        if "as_built" in record:
            return variant
        added = _additions(rng, draws, self, variants=variants)
        kinds = plain(sorted({name.split(".")[1] for name in added}))
        return Variant(parts={**variant.parts, **added}, record={**record, "added": kinds})

    def mesh(self, name: str) -> str:
        """A part's key in the mesh pool."""
        return f"{self.spec.name}/{name}"

    def _variant(
        self, placed: Mapping[str, Array], paints: Mapping[str, Material], record: Mapping[str, JsonValue]
    ) -> Variant:
        worn = {
            name: WornPart(
                mesh=self.mesh(name), T_r=T_r, material=paints.get(_paint(name), self.parts[name].material)
            )
            for name, T_r in placed.items()
        }
        return Variant(parts=worn, record=record)

    def _rebuilt(
        self, rng: np.random.Generator, draws: RobotDraws
    ) -> tuple[dict[str, Array], dict[str, JsonValue]]:
        """Where each part that the variant has is in r, and what was drawn."""
        levels = _Levels.drawn(rng, draws, self.parts)
        names = list(nominal_parts(_with_models(rng, draws, self.parts)))
        # A layer's contents are shifted and turned together, about the robot's middle.
        x_m, y_m, _ = self.spec.cuboid.centre_m
        layers = [_turned(rng, draws, (x_m, y_m)) for _ in range(levels.count + 1)]
        camera = _moved_camera(rng, draws, levels)
        placed: dict[str, Array] = {}
        missing: list[JsonValue] = []
        for name in names:
            kind, bounds_m = name.split(".")[0], self.parts[name].bounds_m
            if kind in OPTIONAL and rng.random() < (
                draws.no_cable_share if kind == "cable" else draws.missing_share
            ):
                missing.append(name)
                continue
            if kind == "camera":
                if camera is not None:
                    placed[name] = camera @ levels.lifted(bounds_m)
            elif kind == "plate":
                placed[name] = levels.stretched(bounds_m)
            elif kind == "post":
                placed[name] = _shifted(rng, draws.post_shift_m) @ levels.stretched(bounds_m)
            elif kind in FIXED:
                placed[name] = np.eye(4)
            elif kind in CONTENTS:
                scale = _scaled(bounds_m, np.exp(rng.uniform(-draws.part_scale, draws.part_scale, 3)))
                placed[name] = layers[levels.layer(bounds_m)] @ levels.lifted(bounds_m) @ scale
            elif kind == "lidar" and name.endswith("head"):
                placed[name] = levels.lifted(bounds_m) @ _spun(rng, self.spec.lidar.x_m)
            elif kind == "cable":
                placed[name] = _slack(rng, bounds_m) @ levels.lifted(bounds_m)
            else:
                placed[name] = levels.lifted(bounds_m)
        record: dict[str, JsonValue] = {
            "undersides_m": plain(levels.new_undersides_m),
            "plate_m": plain(levels.new_thick_m),
            "layers": plain([T[:2].tolist() for T in layers]),
            "camera": plain(None if camera is None else camera[:3, 3]),
            "models": plain(sorted({".".join(m) for n in placed if (m := model_of(n)) is not None})),
            "missing": missing,
        }
        return placed, record

    def _paints(
        self,
        rng: np.random.Generator,
        draws: RobotDraws,
        names: Mapping[str, object],
        *,
        wear: float,
        variants: int,
    ) -> dict[str, Material]:
        """The material of each kind of part, by `_paint`."""
        as_built = {_paint(name): self.parts[name].material for name in names}
        repainted = rng.random() < draws.repainted_share
        dirt = rng.uniform(0.05, 0.35) if rng.random() < draws.dirty_share else 0.0
        # Greyish brown, linear light.
        dust = materials.grey(rng.uniform(0.4, 0.75), rng.uniform(0.0, 0.05))
        paints = {}
        for paint, material in as_built.items():
            if repainted and rng.random() < 0.5:
                draw = materials.metal if material.metallic > 0.5 else materials.plastic
                material = draw(rng, variants)
            material = materials.worn(rng, material, extent=wear)
            if dirt:
                kind = ("concrete", "plaster", "brushed")[rng.integers(3)]
                material = replace(
                    material,
                    base_colour_rgb=_mixed(material.base_colour_rgb, dust, dirt * rng.uniform(0.3, 1.0)),
                    texture=texture_key(kind, int(rng.integers(variants))),
                    texture_scale_m=rng.uniform(0.05, 0.3),
                )
            paints[paint] = material
        return paints


def robot_looks(spec: RobotSpec, parts: Mapping[str, trimesh.Trimesh]) -> tuple[RobotLooks, MeshPool]:
    """A robot's looks and its meshes by key, from its parts by name."""
    built = {
        name: Part(material=part_material(part), bounds_m=np.asarray(part.bounds, np.float64))
        for name, part in parts.items()
    }
    looks = RobotLooks(spec=spec, parts=built)
    return looks, {looks.mesh(name): (part,) for name, part in parts.items()}


def _paint(name: str) -> str:
    """What parts share one material by: the first three words of their names, or the kind of small ones."""
    words = name.split(".")
    return words[0] if words[0] in ("plate", "post", "screw") else ".".join(words[:3])


def _mixed(a: Rgb, b: Rgb, share: float) -> Rgb:
    red, green, blue = ((1.0 - share) * np.array(a) + share * np.array(b)).tolist()
    return red, green, blue


@dataclass(frozen=True, slots=True, kw_only=True)
class _Levels:
    """Heights of plates as built and in a variant [m], from the lowest; empty for a robot without plates."""

    undersides_m: Array
    tops_m: Array
    new_undersides_m: Array
    new_thick_m: float

    @staticmethod
    def drawn(rng: np.random.Generator, draws: RobotDraws, parts: Mapping[str, Part]) -> _Levels:
        """The lowest plate keeps its top, on which the robot's wheels hang."""
        plates = sorted(
            (part.bounds_m[:, 2].tolist() for name, part in parts.items() if name.split(".")[0] == "plate")
        )
        undersides_m, tops_m = np.array(plates).reshape(-1, 2).T
        shifts_m = rng.uniform(-draws.plate_shift_m, draws.plate_shift_m, len(plates))
        factor = rng.uniform(draws.least_plate_thickness, 1.0) if rng.random() < 0.5 else 1.0
        thick_m = factor * float((tops_m - undersides_m).mean()) if plates else 0.0
        new_m = undersides_m + shifts_m
        new_m[:1] = tops_m[:1] - thick_m
        return _Levels(
            undersides_m=undersides_m, tops_m=tops_m, new_undersides_m=np.sort(new_m), new_thick_m=thick_m
        )

    @property
    def count(self) -> int:
        return len(self.tops_m)

    def layer(self, bounds_m: Array) -> int:
        """0 for parts below all plates, else the number of the plate, from 1, that a part stands on."""
        return int(np.searchsorted(self.tops_m, bounds_m[0, 2] + 0.004))

    def top_m(self, layer: int) -> float:
        """Height of the plate that a layer from 1 stands on."""
        return float(self.new_undersides_m[layer - 1] + self.new_thick_m)

    def lifted(self, bounds_m: Array) -> Array:
        """(4, 4) the motion of a part with the plate that it stands on."""
        layer = self.layer(bounds_m)
        rise_m = self.top_m(layer) - self.tops_m[layer - 1] if layer else 0.0
        return _moved(0.0, 0.0, float(rise_m))

    def stretched(self, bounds_m: Array) -> Array:
        """(4, 4) scaling along z of a part that lies in or between plates."""
        old = np.stack([self.undersides_m, self.tops_m], axis=1).ravel()
        new = np.stack([self.new_undersides_m, self.new_undersides_m + self.new_thick_m], axis=1).ravel()
        low_m, high_m = bounds_m[:, 2].tolist()
        new_low_m, new_high_m = np.interp([low_m, high_m], old, new).tolist()
        scale = (new_high_m - new_low_m) / (high_m - low_m)
        T = np.diag([1.0, 1.0, scale, 1.0])
        T[2, 3] = new_low_m - scale * low_m
        return T


def _moved(x_m: float, y_m: float, z_m: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = x_m, y_m, z_m
    return T


def _shifted(rng: np.random.Generator, most_m: float) -> Array:
    x_m, y_m = rng.uniform(-most_m, most_m, 2).tolist()
    return _moved(x_m, y_m, 0.0)


def _scaled(bounds_m: Array, scale: Array) -> Array:
    """(4, 4) scaling of a part about the middle of its underside."""
    x_m, y_m, _ = bounds_m.mean(axis=0).tolist()
    foot = _moved(x_m, y_m, float(bounds_m[0, 2]))
    T: Array = foot @ np.diag([*scale, 1.0]) @ np.linalg.inv(foot)
    return T


def _turned(rng: np.random.Generator, draws: RobotDraws, centre_m: tuple[float, float]) -> Array:
    """(4, 4) a layer's contents shifted, and sometimes turned by quarters about the robot's middle."""
    quarters = int(rng.integers(1, 4)) if rng.random() < draws.turned_layer_share else 0
    middle = _moved(*centre_m, 0.0)
    turn = se3_from_se2(SE2(0.0, 0.0, 0.5 * np.pi * quarters))
    T: Array = _shifted(rng, draws.part_shift_m) @ middle @ turn @ np.linalg.inv(middle)
    return T


def _spun(rng: np.random.Generator, x_m: float) -> Array:
    """(4, 4) any turn of the lidar's head about its axis."""
    T: Array = (
        _moved(x_m, 0.0, 0.0)
        @ se3_from_se2(SE2(0.0, 0.0, rng.uniform(-np.pi, np.pi)))
        @ _moved(-x_m, 0.0, 0.0)
    )
    return T


def _slack(rng: np.random.Generator, bounds_m: Array) -> Array:
    """(4, 4) a cable laid otherwise: scaled by up to 30 %, and mirrored half the time."""
    scale = np.exp(rng.uniform(-0.3, 0.3, 3))
    mirror = np.diag([1.0, -1.0 if rng.random() < 0.5 else 1.0, 1.0, 1.0])
    T: Array = mirror @ _scaled(bounds_m, scale)
    return T


def _with_models(rng: np.random.Generator, draws: RobotDraws, parts: Mapping[str, Part]) -> dict[str, Part]:
    """All parts but those of models of devices that were not drawn."""
    models: dict[str, list[str]] = {}
    for name in parts:
        if (model := model_of(name)) is not None and model[1] not in models.setdefault(model[0], []):
            models[model[0]].append(model[1])
    chosen = {}
    for device, choices in sorted(models.items()):
        first, *others = sorted(choices)
        other = others and rng.random() < draws.other_model_share
        chosen[device] = others[rng.integers(len(others))] if other else first
    return {n: p for n, p in parts.items() if (m := model_of(n)) is None or chosen[m[0]] == m[1]}


def _moved_camera(rng: np.random.Generator, draws: RobotDraws, levels: _Levels) -> Array | None:
    """(4, 4) motion of the camera: none, aside, to another layer; None for a robot without."""
    style = rng.random()
    if style < draws.no_camera_share:
        return None
    if style > draws.no_camera_share + draws.moved_camera_share or not levels.count:
        return np.eye(4)
    # Half the time on the plate above, or one below.
    gap_m = float(np.diff(levels.undersides_m).mean()) if levels.count > 1 else 0.0
    rise_m = gap_m * float(rng.choice([0.0, 0.0, 1.0, -1.0]))
    return _moved(rng.uniform(-0.005, 0.012), rng.uniform(-0.01, 0.06), rise_m)


def _additions(
    rng: np.random.Generator, draws: RobotDraws, looks: RobotLooks, *, variants: int
) -> dict[str, WornPart]:
    """What owners add: a plate on posts above the lidar, a box, a mast, stickers."""
    x_m, y_m, z_m = looks.spec.cuboid.centre_m
    length_m, width_m, height_m = looks.spec.cuboid.size_m
    top_m = z_m + 0.5 * height_m
    added: dict[str, WornPart] = {}

    def block(
        name: str, mesh: str, size_m: Sequence[float], at_m: Sequence[float], material: Material
    ) -> None:
        T_r = _moved(*at_m) @ np.diag([*size_m, 1.0])
        added[f"added.{name}"] = WornPart(mesh=mesh, T_r=T_r, material=material)

    if rng.random() < draws.added_plate_share:
        side_m, rise_m = rng.uniform(0.6, 1.0) * length_m, rng.uniform(0.012, 0.06)
        material, rod = materials.plastic(rng, variants), materials.metal(rng, variants)
        block(
            "plate.0", BOX, (side_m, side_m, rng.uniform(0.003, 0.009)), (x_m, y_m, top_m + rise_m), material
        )
        for i, (sx, sy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1)), start=1):
            at_m = (x_m + 0.42 * side_m * sx, y_m + 0.42 * side_m * sy, 0.5 * (top_m + rise_m + 0.8 * top_m))
            block(f"plate.{i}", CYLINDER, (0.006, 0.006, 0.2 * top_m + rise_m), at_m, rod)
        top_m += rise_m
    if rng.random() < draws.added_box_share:
        size_m = rng.uniform((0.03, 0.03, 0.02), (0.09, 0.09, 0.06))
        # Above the robot, or behind it half-way up.
        if rng.random() < 0.7:
            at_m = (x_m + rng.uniform(-0.03, 0.03), y_m + rng.uniform(-0.04, 0.04), top_m + 0.5 * size_m[2])
        else:
            at_m = (x_m - 0.5 * length_m, y_m + rng.uniform(-0.03, 0.03), z_m + rng.uniform(-0.02, 0.05))
        block("box", BOX, size_m.tolist(), at_m, materials.anything_material(rng, variants))
    if rng.random() < draws.added_mast_share:
        tall_m, foot_m = rng.uniform(0.08, 0.3), 0.75 * top_m
        mast_x_m, mast_y_m = (rng.uniform(-0.4, 0.4, 2) * (length_m, 0.7 * width_m)).tolist()
        at_m = (x_m + mast_x_m, y_m + mast_y_m, foot_m + 0.5 * tall_m)
        block("mast.0", CYLINDER, (0.008, 0.008, tall_m), at_m, materials.metal(rng, variants))
        cube_m = rng.uniform(0.015, 0.05)
        block("mast.1", BOX, (cube_m,) * 3, (*at_m[:2], foot_m + tall_m), materials.plastic(rng, variants))
    for i in range(int(rng.binomial(4, draws.sticker_share))):
        heading_rad, size_m = (
            rng.uniform(-np.pi, np.pi),
            rng.uniform((0.0012, 0.008, 0.006), (0.0012, 0.04, 0.03)),
        )
        # On the robot's outside, within its cuboid.
        reach_m = 0.46 * min(length_m, width_m)
        centre = _moved(x_m, y_m, rng.uniform(0.2, 0.9) * top_m)
        T_r = (
            centre
            @ se3_from_se2(SE2(0.0, 0.0, heading_rad))
            @ _moved(reach_m, 0.0, 0.0)
            @ np.diag([*size_m, 1.0])
        )
        added[f"added.sticker.{i}"] = WornPart(mesh=BOX, T_r=T_r, material=materials.plastic(rng, variants))
    return added
