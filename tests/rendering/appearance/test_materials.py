"""Materials are within what surfaces can be, and the robot's wear is bounded."""

import numpy as np
import pytest

from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Shape, Solid
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.appearance.textures import KINDS, texture_key
from rendezvous.rendering.scene import Material
from tests.floorplan.plans import RADIUS_M, generated

DRAWS = [
    materials.floor_material,
    materials.wall_material,
    materials.ceiling_material,
    materials.anything_material,
    materials.any_texture_material,
    materials.metal,
    materials.leaf,
]


@pytest.mark.parametrize("draw", DRAWS)
def test_a_material_is_of_a_texture_of_the_pool_at_that_textures_scale(draw):
    keys = {texture_key(kind, i): kind for kind in KINDS for i in range(3)}
    for seed in range(60):
        material = draw(np.random.default_rng(seed), 3)
        if material.texture is not None:
            low_m, high_m = KINDS[keys[material.texture]].side_m
            assert low_m <= material.texture_scale_m <= high_m or draw in (
                materials.ceiling_material,
                materials.leaf,
            )


@pytest.mark.parametrize("draw", DRAWS)
def test_equal_rngs_give_equal_materials_and_others_do_not(draw):
    first, again = (draw(np.random.default_rng(1), 3) for _ in "ab")
    assert first == again
    assert len({draw(np.random.default_rng(seed), 3) for seed in range(20)}) == 20


def test_most_walls_are_light():
    tints = np.array([materials.wall_tint(np.random.default_rng(seed)) for seed in range(400)])
    assert np.mean(tints.min(axis=1) > 0.4) > 0.6
    assert np.mean(tints.min(axis=1) < 0.3) > 0.05


def test_a_piece_has_one_material_for_its_body():
    furniture = furnish(generated(0), np.random.default_rng(0), density=1.0, robot_radius_m=RADIUS_M)
    pieces = materials.piece_materials(np.random.default_rng(0), furniture, variants=2)
    assert set(pieces) == {solid.item for solid in furniture}
    body, second = next(pieces[solid.item] for solid in furniture if solid.category == "plant")
    assert second.base_colour_rgb[1] == max(second.base_colour_rgb)
    assert body != second


@pytest.mark.parametrize(
    ("category", "shape", "half_y_m", "z0_m", "z1_m", "second"),
    [
        ("table", Shape.BOX, 0.4, 0.7, 0.75, False),
        ("table", Shape.CYLINDER, 0.03, 0.0, 0.7, True),
        ("table", Shape.CYLINDER, 0.3, 0.0, 0.7, False),
        ("pole", Shape.CYLINDER, 0.03, 0.0, 2.0, False),
        ("bed", Shape.BOX, 0.05, 0.0, 0.8, True),
        ("bed", Shape.BOX, 0.5, 0.0, 1.0, True),
        ("bed", Shape.BOX, 0.5, 0.0, 0.5, False),
        ("plant", Shape.CYLINDER, 0.2, 0.0, 0.3, False),
        ("plant", Shape.CYLINDER, 0.2, 0.3, 1.0, True),
    ],
)
def test_legs_headboards_and_leaves_have_a_material_of_their_own(
    category, shape, half_y_m, z0_m, z1_m, second
):
    solid = Solid(
        shape=shape, x_m=0.0, y_m=0.0, yaw_rad=0.0, half_x_m=half_y_m, half_y_m=half_y_m,
        z0_m=z0_m, z1_m=z1_m, category=category, item=0,
    )  # fmt: skip
    assert materials.is_second(solid) == second


def test_wear_is_bounded_and_no_wear_changes_nothing():
    plate = Material(base_colour_rgb=(0.1, 0.2, 0.3), metallic=0.9, roughness=0.5)
    worn = [materials.worn(np.random.default_rng(seed), plate, extent=1.0) for seed in range(200)]
    colours = np.array([material.base_colour_rgb for material in worn])
    assert (colours / np.array(plate.base_colour_rgb) > np.exp(-0.48) - 1e-9).all()
    assert (colours <= np.array(plate.base_colour_rgb) * np.exp(0.48) + 0.02 + 1e-9).all()
    assert np.ptp(colours[:, 0]) > 0.04
    assert max(abs(material.roughness - 0.5) for material in worn) <= 0.15
    assert materials.worn(np.random.default_rng(0), plate, extent=0.0) == plate


def test_plastic_never_wears_to_metal():
    case = Material(base_colour_rgb=(0.1, 0.1, 0.1), metallic=0.0, roughness=0.5)
    assert all(materials.worn(np.random.default_rng(s), case, extent=1.5).metallic == 0.0 for s in range(50))
