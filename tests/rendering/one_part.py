"""A robot of one dark part, for tests of scenes."""

import numpy as np

from rendezvous.rendering.robot_family import Part, RobotLooks
from rendezvous.rendering.scene import Material
from rendezvous.robot_file import load_robot


def one_part_looks():
    dark = Material(base_colour_rgb=(0.02, 0.02, 0.02), roughness=0.6)
    bounds_m = np.array([[-0.1, -0.07, 0.01], [0.03, 0.07, 0.15]])
    return RobotLooks(spec=load_robot("burger"), parts={"shell": Part(material=dark, bounds_m=bounds_m)})
