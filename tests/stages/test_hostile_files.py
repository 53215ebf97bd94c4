"""Small files that hung, blew up or ended in a traceback, where they are at hand.

Each is read in a process of its own with little memory: it is used, quarantined with its reason, or ends in
one line that `rendezvous` prints.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

FOLDER = Path(os.environ.get("RENDEZVOUS_TEST_DATA", ROOT / "../shared/data")) / "hostile"
NAMES = sorted(path.name for path in FOLDER.glob("*.*"))

MOST_S = 60  # for what takes two seconds where nothing else runs
MOST_MB = 500  # of data, beside the libraries

READ = """
import resource, sys
from functools import partial
from pathlib import Path
from rendezvous.config.load import load_config
from rendezvous.errors import PipelineError
from rendezvous.floorplan.validate import validated
from rendezvous.interop.map_image import read_map_image
from rendezvous.interop.ros_map import read_ros_map
from rendezvous.robot_file import load_robot
from rendezvous.stages.floorplans import _read_candidates, usable_plans

path, megabytes = Path(sys.argv[1]), int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_DATA, (megabytes << 20, megabytes << 20))


def plans(path):
    judge = partial(validated, robot_radius_m=0.105)
    for entry in usable_plans(_read_candidates(str(path)), judge, 0.105).quarantined:
        (line,) = entry.reason.splitlines()
        print(ascii(line))


kinds = {
    "stages": load_config,
    "robot": lambda path: load_robot(str(path)),
    "map": partial(read_ros_map, strict=False),
}
read = kinds.get(path.name.split("_")[0]) or (read_map_image if path.suffix == ".png" else plans)
try:
    read(path)
    print("read")
except PipelineError as error:
    (line,) = str(error).splitlines()
    print(ascii(line))
"""


@pytest.mark.parametrize("name", NAMES or [None])
def test_a_hostile_file_at_hand_is_read_or_told_in_one_line(name: str | None):
    if name is None:
        pytest.skip(f"no hostile files at {FOLDER}; RENDEZVOUS_TEST_DATA names the folder above")
    done = subprocess.run(
        [sys.executable, "-c", READ, str(FOLDER / name), str(MOST_MB)],
        capture_output=True, text=True, timeout=MOST_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout
