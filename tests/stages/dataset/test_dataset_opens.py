"""The published dataset is opened by the programs that users have."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rendezvous.stages.pack import pack
from tests.synthetic_dataset import explored, synthetic_run


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    explored(folder)
    pack(synthetic_run(folder))
    return folder / "dataset"


# The programs run in a process of their own, as a user's would, with no trace of this package.

_DATASETS = """
import datasets, sys
pairs = datasets.load_dataset(sys.argv[1])
assert set(pairs) == {"train", "validation", "test"}, pairs
assert sum(len(split) for split in pairs.values()) == 20
row = pairs["train"][0]
assert isinstance(pairs["train"].features["map_0"], datasets.Image)
assert row["map_0"].mode == "L" and {value for _, value in row["map_0"].getcolors()} <= {0, 205, 254}
assert len(row["T_m0_m1_local"]) == 3 and len(row["T_c_o"]) == 16
assert row["image"].mode == "RGB" and row["image"].size == (640, 480)
for streamed in datasets.load_dataset(sys.argv[1], split="test", streaming=True):
    assert streamed["map_1"].size[0] > 10 and len(streamed["trajectory_0"]) > 10
"""

_DATASETS_POSES = """
import datasets, sys
poses = datasets.load_dataset(sys.argv[1], "poses")
assert set(poses) == {"train", "validation", "test"}, poses
assert sum(len(split) for split in poses.values()) == 60
assert isinstance(poses["train"].features["image"], datasets.Image)
assert all(row["image"].mode == "RGB" and row["image"].size == (640, 480) for row in poses["validation"])
absent = [row for row in poses["train"] if row["T_c_o"] is None]
assert absent and all(row["visibility"] == 0 and row["projected_cuboid_px"] is None for row in absent)
streamed = list(datasets.load_dataset(sys.argv[1], "poses", split="test", streaming=True))
assert len(streamed) == len(poses["test"]) and streamed[0]["image"].size == (640, 480)
"""

_DUCKDB = """
import duckdb, sys
counts = "count(*), count(distinct plan_id), max(len(T_m0_r0))"
assert duckdb.sql(f"select {counts} from '{sys.argv[1]}/pairs/*.parquet'").fetchall() == [(20, 10, 3)]
assert duckdb.sql(f"select * from '{sys.argv[1]}/pairs/*.parquet' where overlap > 1").fetchall() == []
png = duckdb.sql(f"select map_0.bytes from '{sys.argv[1]}/pairs/train-*.parquet'").fetchall()[0][0]
assert png.startswith(b"\\x89PNG")
[[rows, visibility]] = duckdb.sql(
    f"select count(*), avg(visibility) from '{sys.argv[1]}/poses/*.parquet'"
).fetchall()
assert rows == 60 and 0.2 < visibility < 0.8, (rows, visibility)
"""

_POLARS = """
import polars, sys
pairs = polars.read_parquet(f"{sys.argv[1]}/pairs/*.parquet")
assert pairs.height == 20 and pairs["plan_id"].n_unique() == 10
assert pairs["map_0"].struct.field("bytes")[0].startswith(b"\\x89PNG")
assert pairs["T_m0_m1_local"].dtype == polars.Array(polars.Float64, 3)
lazy = polars.scan_parquet(f"{sys.argv[1]}/pairs/train-*.parquet").filter(polars.col("overlap") > 2).collect()
assert lazy.height == 0
poses = polars.read_parquet(f"{sys.argv[1]}/poses/*.parquet")
assert poses.height == 60 and poses["image"].struct.field("bytes")[0].startswith(b"\\xff\\xd8")
assert poses["T_c_o"].dtype == polars.Array(polars.Float64, 16) and poses["T_c_o"].null_count() == 12
"""


@pytest.mark.parametrize(
    "program",
    [_DATASETS, _DATASETS_POSES, _DUCKDB, _POLARS],
    ids=["datasets", "datasets-poses", "duckdb", "polars"],
)
def test_opens_with_no_options_in(program, dataset, tmp_path):
    environment = {"HF_HOME": str(tmp_path), "HF_DATASETS_OFFLINE": "1", "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program, str(dataset)],
        env={"PATH": "", "HOME": str(tmp_path), **environment},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
