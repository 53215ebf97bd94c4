from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

pytest.importorskip("matplotlib")

from rendezvous.cli.__main__ import app
from rendezvous.commands.evaluate.relative_pose import PoseEvaluation, evaluate_pose
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.dataset.sampling import rows_at
from rendezvous.geometry.camera import rotation_from_rpy
from rendezvous.geometry.se2 import SE2
from rendezvous.stages.pack import pack
from rendezvous.stages.training.seen_images import PLAUSIBLE, SIGHTING, read_images
from rendezvous.store.read import StageReader
from tests.commands.evaluate.toy_evaluation import toy_dataset
from tests.evaluation.pages import require_self_contained
from tests.stages.toy_sources import ToySource
from tests.synthetic_dataset import POSE_ROWS, explored, rendered, synthetic_run

SIDEWAYS = np.eye(4)
SIDEWAYS[1, 3] = 0.05


@pytest.fixture(autouse=True)
def no_charts(monkeypatch):
    """Drawing takes longer than all else; `monkeypatch.undo()` has charts drawn."""
    monkeypatch.setattr("rendezvous.evaluation.relative_pose.report.violin_chart", lambda *_: "a chart")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return toy_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def images(data):
    return read_images(StageReader(f"{data}/dataset"), "test")


def _evaluated(data: Path, folder: Path, source: ToySource | None, **settings) -> tuple[dict, str]:
    """What `metrics.json` holds, and what was told."""
    told = io.StringIO()
    settings = {"records": folder / "records", **settings}
    evaluate_pose(
        PoseEvaluation(
            dataset=f"{data}/dataset", folder=folder, source=source, console=Console(file=told), **settings
        )
    )
    return json.loads((folder / "metrics.json").read_text())["relative_pose"], told.getvalue()


def test_an_estimator_that_tells_the_truth_reaches_everything(data, images, tmp_path, monkeypatch):
    monkeypatch.undo()
    metrics, _ = _evaluated(data, tmp_path, ToySource.of(images))
    figures = metrics["variants"]["floor"]["figures"]
    assert figures["overall"]["detected"]["of"] == sum(image.truth.shows_robot for image in images) > 8
    assert figures["overall"]["detected"]["count"] == figures["overall"]["detected"]["of"]
    assert figures["overall"]["position_m"]["largest"] == pytest.approx(0.0, abs=1e-9)
    assert figures["false_detections"] == {
        "count": 0,
        "of": sum(not image.truth.shows_robot for image in images),
    }
    assert figures["false_detections"]["of"] > 0
    assert figures["false_covered"] == {
        "count": 0,
        "of": sum(image.box_px is not None for image in images),
    }
    assert all(share["count"] == share["of"] for share in figures["coverage"]["inside"])
    page = (tmp_path / "index.html").read_text()
    anchors = require_self_contained(page)
    assert {"relative_pose", "relative_pose-distance", "relative_pose-gallery"} <= anchors
    assert "not reached" not in page
    assert "Intervals of shares are Wilson's, which takes images as independent" in page
    assert "the SLAM poses, which T̃ rests on as well, are taken as exact" in page


def test_errors_confusions_and_the_floors_gain_are_told(data, images, tmp_path):
    source = ToySource.of(images, off=SE2(0.1, 0.0, 3.0), makes_up=SE2(1.0, 0.0, 0.0))
    metrics, _ = _evaluated(data, tmp_path, source)
    floor, free = (metrics["variants"][name]["figures"] for name in ("floor", "free"))
    assert floor["overall"]["median"] == pytest.approx([0.1, 0.0, 3.0])
    assert floor["overall"]["confused"]["count"] == floor["overall"]["detected"]["of"]
    assert free["overall"]["confused"]["count"] == 0  # twice 3 rad is nearly a whole turn
    assert floor["false_detections"]["count"] == floor["false_detections"]["of"] > 0
    assert floor["false_covered"]["count"] == floor["false_covered"]["of"] > 8
    assert metrics["floor_gain"]["heading_rad"]["value"] > 2.0
    assert "False detections" in (tmp_path / "index.html").read_text()


def test_nothing_found_is_a_report_too(data, images, tmp_path):
    metrics, _ = _evaluated(data, tmp_path, ToySource.of(images, finds=False))
    assert metrics["variants"]["floor"]["figures"]["overall"]["detected"]["count"] == 0
    assert metrics["floor_gain"] is None
    page = (tmp_path / "index.html").read_text()
    of_detections = {f"relative_pose-{name}" for name in ("extremes", "calibration", "window")}
    assert not of_detections & require_self_contained(page)
    assert "a near, clearly visible robot was measured, or it was found in none" in page
    assert "Missed" in page


def test_one_variant_can_be_measured_and_the_other_stands_beside_it_as_recorded(data, images, tmp_path):
    source = ToySource.of(images)
    _, told = _evaluated(data, tmp_path, source, floor=False, record=True)
    assert "recorded" in told
    assert [path.name for path in (tmp_path / "records").iterdir()] == ["free.json"]
    metrics, _ = _evaluated(data, tmp_path, source, floor=True, count=5)
    assert {name: row["source"] for name, row in metrics["variants"].items()} == {
        "floor": "measured",
        "free": "recorded",
    }
    assert metrics["variants"]["floor"]["conditions"]["images"] == 5
    with pytest.raises(ConfigError, match=r"free\.json: recorded from \d+ images, which --record would"):
        _evaluated(data, tmp_path, source, floor=False, count=5, record=True)
    (tmp_path / "records" / "free.json").write_text('{"format": 1}')
    with pytest.raises(StoreError, match=r"no recorded figures .*`rendezvous evaluate-pose --record`"):
        _evaluated(data, tmp_path, source)


def test_the_same_is_not_measured_twice_and_other_weights_are(data, images, tmp_path):
    source = ToySource.of(images)
    first, told = _evaluated(data, tmp_path, source)
    assert "as measured before" not in told
    again, told = _evaluated(data, tmp_path, source)
    assert told.count("as measured before") == 2
    assert again == first
    _, told = _evaluated(data, tmp_path, replace(source, digest="other"))
    assert "as measured before" not in told


def test_plans_that_the_estimator_knows_are_told(data, images, tmp_path):
    metrics, told = _evaluated(data, tmp_path, ToySource.of(images, plans=(images[0].plan_digest[:8],)))
    assert "warning: trained on 1 of these" in told
    assert metrics["conditions"]["trained_on"] == {"relative pose": 1}


def test_plans_that_the_estimator_knows_are_left_out_if_asked(data, images, tmp_path):
    known = images[0].plan_digest[:8]
    seen = sum(image.plan_digest.startswith(known) for image in images)
    source = ToySource.of(images, plans=(known,))
    metrics, told = _evaluated(data, tmp_path, source, unseen=True)
    assert f"left out {seen} of {len(images)} images" in told
    assert metrics["conditions"]["images"] == len(images) - seen
    assert metrics["conditions"]["trained_on"] == {"relative pose": 0}
    every = tuple({image.plan_digest[:8] for image in images})
    with pytest.raises(StoreError, match="trained on the floor plans of all"):
        _evaluated(data, tmp_path, ToySource.of(images, plans=every), unseen=True)


def test_a_larger_draw_holds_a_smaller_one(data, images):
    reader = StageReader(f"{data}/dataset")
    few, more = (
        {image.truth.image_id for image in read_images(reader, "test", count=count)} for count in (4, 9)
    )
    assert len(few) == 4
    assert few < more < {image.truth.image_id for image in images}


def test_kinds_are_read_apart_and_free_images_not_at_all(data, images):
    reader = StageReader(f"{data}/dataset")
    kinds = {kind: read_images(reader, "test", kinds=(kind,)) for kind in (PLAUSIBLE, SIGHTING)}
    assert sum(map(len, kinds.values())) == len(images)
    for kind, found in kinds.items():
        assert {image.truth.kind for image in found} == {kind}
        assert all(image.T_r0_c is not None for image in found)


def test_images_are_read_from_a_split_without_pairs(data, images, monkeypatch):
    shards = StageReader.shards
    monkeypatch.setattr(
        StageReader, "shards", lambda self, under="": [] if "pairs/" in under else shards(self, under)
    )
    found = read_images(StageReader(f"{data}/dataset"), "test")
    assert {one.truth.image_id for one in found} == {
        one.truth.image_id for one in images if one.truth.kind == PLAUSIBLE
    }


def test_what_rendered_an_image_is_read_from_what_was_drawn(tmp_path):
    engines = ({}, {"engine": "pyrender"}, {"engine": "cycles"})
    plausible = [row for row in POSE_ROWS[0] if row["mode"] == PLAUSIBLE][:3]
    rows = [row | {"drawn": json.dumps(engine)} for row, engine in zip(plausible, engines, strict=True)]
    explored(tmp_path)
    rendered(tmp_path, views=False, poses=[rows])
    pack(synthetic_run(tmp_path, "pack.validation_fraction=0", "pack.test_fraction=1"))
    images = read_images(StageReader(f"{tmp_path}/dataset"), "test")
    assert [image.truth.renderer for image in images] == ["rasterised", "rasterised", "path-traced"]


def test_the_true_pose_is_that_of_the_robots(images):
    plausible = [image.truth.T_r0_r1 for image in images if image.truth.kind == PLAUSIBLE]
    poses = [pose for pose in plausible if pose is not None]
    assert poses
    for pose in poses:
        assert pose.y_m == pytest.approx(0.0, abs=1e-9)
        assert 0.5 <= pose.x_m <= 3.0


def test_a_camera_that_stands_askew_changes_what_is_given_and_not_the_truth(data, tmp_path):
    askew = np.eye(4)
    askew[:3, :3] = rotation_from_rpy(0.0, 0.05, 0.0)
    rows = [
        [row if row["T_r0_c"] is None else {**row, "T_r0_c": askew @ row["T_r0_c"]} for row in plan]
        for plan in POSE_ROWS
    ]
    explored(tmp_path)
    rendered(tmp_path, poses=rows, parameters={"askew": True})
    pack(synthetic_run(tmp_path))
    level, tilted = (
        {image.truth.image_id: image for image in read_images(StageReader(f"{folder}/dataset"), "test")}
        for folder in (data, tmp_path)
    )
    assert level.keys() == tilted.keys()
    for name, image in tilted.items():
        assert image.truth == level[name].truth or image.truth.T_r0_r1 is None
        if image.truth.kind == PLAUSIBLE:
            assert image.T_r0_c == pytest.approx(askew @ level[name].T_r0_c)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"split": "tests"}, "--split is 'tests'; must be one of train, validation, test"),
        ({"kinds": ("free",)}, "--images names 'free'; must be of plausible, sighting"),
        ({"kinds": ()}, "--images names nothing; must name plausible or sighting, or both"),
        (
            {"weights": Path("none.safetensors")},
            "none.safetensors: no weights of the relative-pose estimator",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line(data, tmp_path, settings, told):
    with pytest.raises((ConfigError, StoreError), match=told):
        _evaluated(data, tmp_path, None, **settings)


@pytest.mark.parametrize(
    ("known", "cuboid"),
    [
        ({"size_m": (0.138, 0.178, 0.192)}, "0.138 x 0.178 x 0.192 m around (0, 0, 0) m"),
        ({"T_r1_o": SIDEWAYS}, "0.3 x 0.2 x 0.1 m around (0, 0.05, 0) m"),
    ],
)
def test_images_of_a_robot_that_the_weights_do_not_know_are_told(data, images, tmp_path, known, cuboid):
    with pytest.raises(ConfigError) as caught:
        _evaluated(data, tmp_path, ToySource.of(images, **known))
    told = str(caught.value)
    assert f"the weights: knows the robot 'toy', whose cuboid is {cuboid}; that of " in told
    assert "dataset, in plan-" in told
    assert ", is 0.3 x 0.2 x 0.1 m around (0, 0, 0) m: `rendezvous train-pose` on images of" in told


@pytest.mark.parametrize("kind", [PLAUSIBLE, SIGHTING])
def test_every_column_that_is_read_is_missed_by_its_name(data, monkeypatch, kind):
    reader = StageReader(f"{data}/dataset")
    read, names = StageReader.table, _columns_read(reader, kind, monkeypatch)
    assert {"T_c_o", "image", "K"} < names
    for name in names:

        def without(self, shard, *, columns=None, name=name):
            table = read(self, shard, columns=columns)
            return table.drop_columns([name]) if name in table.column_names else table

        monkeypatch.setattr(StageReader, "table", without)
        with pytest.raises(StoreError, match=f"has no column '{name}'; must be as `rendezvous pack`"):
            read_images(reader, "test", kinds=(kind,))


def _columns_read(reader: StageReader, kind: str, monkeypatch) -> set[str]:
    """The columns of a row that become part of an image."""
    asked = set[str]()

    class Row(dict):
        def __getitem__(self, name):
            asked.add(name)
            return super().__getitem__(name)

    def rows(*arguments):
        return [Row(row) for row in rows_at(*arguments)]

    with monkeypatch.context() as patched:
        patched.setattr("rendezvous.stages.training.seen_images.rows_at", rows)
        read_images(reader, "test", kinds=(kind,))
    return asked


def test_a_dataset_without_images_is_told_in_one_line(tmp_path):
    explored(tmp_path)
    rendered(tmp_path, views=False, poses=())
    pack(synthetic_run(tmp_path))
    with pytest.raises(StoreError, match="no plausible or sighting images of split test; must be a dataset"):
        _evaluated(tmp_path, tmp_path / "report", None)


@pytest.mark.parametrize("command", ["evaluate-pose", "evaluate-fusion"])
def test_the_commands_name_what_is_missing_in_one_line(data, tmp_path, command):
    options = ["--data", str(data), "--weights", str(tmp_path / "no.safetensors"), "--workers", "1"]
    result = CliRunner().invoke(app, [command, *options, "--report", str(tmp_path)])
    assert result.exit_code == 2
    assert (
        "no.safetensors: no weights of the relative-pose estimator; `rendezvous train-pose`" in result.stderr
    )
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
