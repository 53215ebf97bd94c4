"""Writes the Burger by its maker's meshes as a robot of its own: does what learnt our model know it?

    python -m benchmarks.maker_robot FOLDER
    rendezvous dataset --preset pathtraced --set explore.robot=FOLDER/robot.yaml \
        --set render.draws.robot.as_built_share=1.0 --data DATA

The meshes have no colours: each face gets those of the nearest part of our model.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from benchmarks.robot_shape import NO_MESHES, maker_folder, maker_parts
from rendezvous.rendering.robot_model import nominal_parts, part_material, robot_glb, robot_parts
from rendezvous.resources import ROBOTS
from rendezvous.robot_file import load_robot, load_robot_model

_POINTS = 4000


def write(folder: Path, meshes: Path) -> None:
    """Write robot file, MJCF and model into the folder."""
    ours = nominal_parts(robot_parts(load_robot_model("burger"), source="burger"))
    names = list(ours)
    points = [trimesh.sample.sample_surface(part, _POINTS, seed=0)[0] for part in ours.values()]
    nearest = cKDTree(np.concatenate(points))
    cuboid, parts = load_robot("burger").cuboid, {}
    bounds_m = np.array(cuboid.centre_m) + np.outer([-0.5, 0.5], cuboid.size_m)
    for name, mesh in maker_parts(meshes).items():
        mesh.vertices = mesh.vertices.clip(*bounds_m)  # caster and tyres reach 0.1 mm out of it
        _, place = nearest.query(mesh.triangles_center)
        owner = place // _POINTS
        for index in np.unique(owner):
            piece = mesh.submesh([np.flatnonzero(owner == index)], append=True)
            parts[f"maker_{name}.{names[index]}"] = (piece, part_material(ours[names[index]]))
    folder.mkdir(parents=True, exist_ok=True)
    for file in ("robot.yaml", "robot.xml"):
        shutil.copy(ROBOTS / "burger" / file, folder / file)
    (folder / "robot.glb").write_bytes(robot_glb(parts))
    print(f"{folder}: {len(parts)} pieces")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder, meshes = parser.parse_args().folder, maker_folder()
    if meshes is None:
        parser.error(NO_MESHES)
    write(folder, meshes)
