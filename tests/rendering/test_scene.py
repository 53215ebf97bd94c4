from __future__ import annotations

import numpy as np
import pytest

from rendezvous.errors import PipelineError
from rendezvous.rendering.scene import Material, robot_view
from tests.rendering.scenes import placed, scene_of, sun


def test_names_are_unique():
    with pytest.raises(PipelineError, match="more than one instance named box"):
        scene_of(placed("box", (1, 0, 0), name="box"), placed("box", (2, 0, 0), name="box"))


def test_a_background_of_another_size_is_refused():
    with pytest.raises(
        PipelineError, match=r"background of shape \(2, 2, 3\); the camera has \(144, 208, 3\)"
    ):
        scene_of(background=np.zeros((2, 2, 3), dtype=np.uint8))


@pytest.mark.parametrize(("count", "shadow"), [(9, False), (3, True)])
def test_more_lights_than_the_shader_has_are_refused(count: int, shadow: bool):
    with pytest.raises(PipelineError, match=f"{count} lights, .* at most 8 and 2"):
        scene_of(lights=count * (sun(casts_shadow=shadow),))


def test_a_point_light_throws_no_shadow():
    with pytest.raises(PipelineError, match="point light casts no shadow"):
        sun(kind="point", casts_shadow=True)


@pytest.mark.parametrize("wrong", [{"roughness": 1.2}, {"metallic": -0.1}, {"texture_scale_m": 0.0}])
def test_a_material_out_of_range_is_refused(wrong: dict[str, float]):
    with pytest.raises(PipelineError, match="material"):
        Material(base_colour_rgb=(0.5, 0.5, 0.5), **wrong)


def test_the_robot_is_the_instance_of_that_name_and_the_parts_under_it():
    names = ["r1", "r1/wheel", "r10", "r0", "wall/r1"]
    scene = scene_of(*(placed("box", (i, 0, 0), name=name) for i, name in enumerate(names)), robot="r1")
    assert scene.robot_ids() == (0, 1)


def test_the_silhouette_holds_the_visible_pixels_where_two_passes_round_apart():
    ids = np.full((6, 8), -1, np.int32)
    ids[2:4, 3:6] = 1
    view = robot_view(ids, (1,), silhouette_px=5)
    assert (view.visible_px, view.silhouette_px, view.visibility) == (6, 6, 1.0)
    assert view.box_px == (2.5, 1.5, 5.5, 3.5)
