from __future__ import annotations

import numpy as np
from rendezvous.rendering.scene import robot_view


def test_the_silhouette_holds_the_visible_pixels_where_two_passes_round_apart():
    ids = np.full((6, 8), -1, np.int32)
    ids[2:4, 3:6] = 1
    view = robot_view(ids, (1,), silhouette_px=5)
    assert (view.visible_px, view.silhouette_px, view.visibility) == (6, 6, 1.0)
    assert view.box_px == (2.5, 1.5, 5.5, 3.5)
