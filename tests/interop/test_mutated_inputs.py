"""Whole inputs with a few edits are read or refused with a `PipelineError`, whatever the edits are."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rendezvous.config.load import load_config
from rendezvous.errors import PipelineError
from rendezvous.floorplan.houseexpo import parse_floorplan
from rendezvous.floorplan.validate import validated
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.interop.camera_info import camera_info_bytes, read_camera_info
from rendezvous.interop.houseexpo_files import parsed_json
from rendezvous.interop.map_image import read_map_image
from rendezvous.interop.ros_map import read_ros_map
from rendezvous.robot_file import load_robot
from tests.conftest import ROOT

GREYS = np.full((20, 30), 205, np.uint8)
CAMERA = PinholeCamera(fx_px=600.0, fy_px=600.0, cx_px=320.0, cy_px=240.0, width_px=640, height_px=480)
MAP = b"image: m.pgm\nresolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def read_plan(path: Path) -> None:
    data = parsed_json(path.read_bytes(), str(path))
    validated(parse_floorplan(data, source=str(path)), robot_radius_m=0.105)


WHOLE: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "stages.yaml": ((ROOT / "stages.yaml").read_bytes(), load_config),
    "robot.yaml": (
        (ROOT / "assets" / "robots" / "burger" / "robot.yaml").read_bytes(),
        lambda path: load_robot(str(path)),
    ),
    "map.yaml": (MAP, lambda path: read_ros_map(path, strict=False)),
    "camera.yaml": (camera_info_bytes(CAMERA, "camera"), read_camera_info),
    "plan.json": ((ROOT / "floorplans" / "rdv-000.json").read_bytes(), read_plan),
    "plain.pgm": (b"P2\n3 2\n255\n1 2 3 # x\n4 5 6\n", read_map_image),
    **{
        f"map.{kind}": (cv2.imencode(f".{kind}", GREYS)[1].tobytes(), read_map_image)
        for kind in ("png", "bmp")
    },
}
PIECES = [
    b"*a", b"&a ",
    b"!!int ", b"!!bool ", b"[", b"{", b"<<: ", b".nan", b"1e999", b"0x" + b"f" * 40, b'"\\ud800"',
    b"- ", b"? ", b": ", b"null", b"-1", b"9" * 20, b"\0", b"\xff", b"true", b"''", b"2024-01-01",
    b"%", b"|",
]  # fmt: skip
EDITS = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 20), st.sampled_from(PIECES) | st.binary(max_size=4)),
    min_size=1,
    max_size=4,
)


@pytest.mark.parametrize("name", WHOLE)
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits=EDITS)
def test_an_edited_input_is_read_or_refused(tmp_path: Path, name: str, edits: list[tuple[float, int, bytes]]):
    whole, read = WHOLE[name]
    content = bytearray(whole)
    for share, left_out, piece in edits:
        at = int(share * len(content))
        content[at : at + left_out] = piece
    (tmp_path / "m.pgm").write_bytes(cv2.imencode(".pgm", GREYS)[1].tobytes())
    path = tmp_path / name
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read(path)
        except PipelineError as error:
            assert len(str(error).splitlines()) == 1  # noqa: PT017 - or it is read
