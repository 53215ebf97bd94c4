"""Small things have true sizes, stand on the floor, and touch nothing."""

import numpy as np
import pytest
import shapely

from rendezvous.rendering.distractors import LOOK_ALIKES, THINGS, draw_thing, place_on_floor
from rendezvous.rendering.plan_scene import plan_meshes
from rendezvous.rendering.thing_meshes import thing_meshes

MESHES = {**plan_meshes(), **thing_meshes()}


def _vertices_m(thing):
    """(N, 3) [m] in t, and the number of the part that each is of."""
    points, owner = [], []
    for i, part in enumerate(thing.parts):
        for mesh in MESHES[part.mesh]:
            p = np.asarray(mesh.vertices)
            points.append(p @ part.T_t[:3, :3].T + part.T_t[:3, 3])
            owner.append(np.full(len(p), i))
    return np.concatenate(points), np.concatenate(owner)


@pytest.mark.parametrize("kind", THINGS)
@pytest.mark.parametrize("seed", range(6))
def test_a_thing_stands_on_the_floor_within_its_circle_and_height(kind, seed):
    thing = THINGS[kind](np.random.default_rng(seed), 3)
    p_t, _ = _vertices_m(thing)
    assert p_t[:, 2].min() == pytest.approx(0.0, abs=2e-3)
    assert np.hypot(p_t[:, 0], p_t[:, 1]).max() <= thing.radius_m + 2e-3
    assert 0.5 * thing.height_m <= p_t[:, 2].max() <= thing.height_m + 2e-3
    assert thing.radius_m < 0.75
    assert thing.height_m < 0.8


@pytest.mark.parametrize("kind", THINGS)
def test_no_part_of_a_thing_hangs_in_the_air(kind):
    p_t, owner = _vertices_m(THINGS[kind](np.random.default_rng(1), 3))
    bottoms_m = sorted((p_t[owner == i, 2].min(), p_t[owner == i, 2].max()) for i in np.unique(owner))
    reached_m = 0.0
    for bottom_m, top_m in bottoms_m:
        assert bottom_m <= reached_m + 2e-3
        reached_m = max(reached_m, top_m)


@pytest.mark.parametrize("kind", THINGS)
def test_equal_rngs_give_equal_things(kind):
    first, again, other = (THINGS[kind](np.random.default_rng(s), 3) for s in (4, 4, 5))
    assert all(np.array_equal(a.T_t, b.T_t) for a, b in zip(first.parts, again.parts, strict=True))
    assert [part.material for part in first.parts] == [part.material for part in again.parts]
    assert (first.radius_m, first.height_m) != (other.radius_m, other.height_m)


def test_meshes_face_outwards_so_that_culling_leaves_them():
    for key, (mesh,) in thing_meshes().items():
        if key != "thing/leaves":  # which have two sides and no inside
            closed = mesh.copy()
            closed.merge_vertices(merge_norm=True, merge_tex=True)
            assert closed.volume > 0.0, key


def test_a_thing_is_put_where_it_touches_neither_walls_nor_what_stands_there():
    rng = np.random.default_rng(0)
    floor = shapely.box(0, 0, 2, 2).difference(shapely.box(0.8, 0.8, 1.2, 1.2))
    taken = [(0.4, 0.4, 0.2)]
    placed = 0
    for _ in range(200):
        thing = THINGS["carton"](rng, 1)
        pose = place_on_floor(rng, thing, free=floor, xy_m=rng.uniform(-0.5, 2.5, (8, 2)), taken=taken)
        if pose is None:
            continue
        placed += 1
        p_t, _ = _vertices_m(thing)
        hull = shapely.MultiPoint(pose @ p_t[:, :2]).convex_hull
        assert floor.buffer(1e-6).covers(hull)
        assert hull.distance(shapely.Point(0.4, 0.4)) >= 0.2
    assert placed > 100


def test_a_thing_without_a_place_is_not_put_anywhere():
    thing = THINGS["bag"](np.random.default_rng(0), 1)
    narrow = shapely.box(0, 0, 5, thing.radius_m)
    xy_m = np.array([[2.0, 0.5 * thing.radius_m]])
    assert place_on_floor(np.random.default_rng(0), thing, free=narrow, xy_m=xy_m, taken=[]) is None


def test_instances_of_a_thing_are_at_its_pose():
    thing = THINGS["cup"](np.random.default_rng(0), 1)
    T_w_t = np.eye(4)
    T_w_t[:3, 3] = 1.0, 2.0, 0.0
    instances = thing.instances(T_w_t, name="cup")
    assert [instance.name for instance in instances] == ["cup/0", "cup/1"]
    assert all(
        np.allclose(instance.T_w[:3, 3] - part.T_t[:3, 3], [1.0, 2.0, 0.0])
        for instance, part in zip(instances, thing.parts, strict=True)
    )


def test_a_share_of_the_things_looks_like_the_robot():
    rng = np.random.default_rng(0)
    drawn = [draw_thing(rng, variants=1, look_alike_share=0.7).kind for _ in range(600)]
    expected = 0.7 + 0.3 * len(LOOK_ALIKES) / len(THINGS)
    assert np.mean([kind in LOOK_ALIKES for kind in drawn]) == pytest.approx(expected, abs=0.06)
    # Without a share, the draws are those of a dataset that knows of none.
    one, other = np.random.default_rng(1), np.random.default_rng(1)
    first = draw_thing(one, variants=1, look_alike_share=0.0)
    assert first.kind == draw_thing(other, variants=1).kind
    assert one.random() == other.random()
