"""Floor plans from files and from the generator, on their way into shards."""

from __future__ import annotations

import io
import json
import random
import re
import tarfile
import tracemalloc
from importlib import import_module
from pathlib import Path

import pytest

from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.floorplan.houseexpo import to_houseexpo
from rendezvous.floorplan.validate import start_regions, validated
from rendezvous.interop.houseexpo_files import plan_files
from rendezvous.plan_schema import plan_of
from rendezvous.stages.floorplans import floorplans
from rendezvous.store.read import StageReader
from tests.conftest import ROOT, MakeRun
from tests.floorplan.plans import RADIUS_M
from tests.toy_stage import folder_content

# Two rooms of 4 m with a door of 0.9 m between them.
VERTS = [[0, 0], [3.95, 0], [3.95, 1.5], [4.05, 1.5], [4.05, 0], [8, 0], [8, 4]]
VERTS += [[4.05, 4], [4.05, 2.4], [3.95, 2.4], [3.95, 4], [0, 4]]


def plan(plan_id: str, *, width_m: float = 8.0, **extra: object) -> dict:
    verts = [[width_m if x == 8 else x, y] for x, y in VERTS]
    return {"id": plan_id, "verts": verts, "room_category": {"Bedroom": [[0, 0, 3.95, 4]]}, **extra}


def write(folder: Path, **contents: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        text = content if isinstance(content, str) else json.dumps(content)
        (folder / f"{name}.json").write_text(text)
    return folder


def archive(path: Path, folder: Path) -> Path:
    with tarfile.open(path, "w:gz") as tar:
        tar.add(folder, arcname="json")
    return path


def read_run(make_run: MakeRun, *sources: Path, generate: int = 0, per_shard: int = 2, **options) -> Run:
    return make_run(
        [
            f"floorplans.sources={json.dumps([str(source) for source in sources])}",
            f"floorplans.generate.count={generate}",
            f"floorplans.plans_per_shard={per_shard}",
        ],
        **options,
    )


def rows_of(run: Run) -> list[dict]:
    return list(run.read("floorplans").rows())


def said(run: Run) -> str:
    return run.console.file.getvalue()


def test_a_plan_becomes_a_row_that_gives_the_plan_back(make_run: MakeRun, tmp_path: Path):
    run = read_run(make_run, write(tmp_path / "plans", a=plan("a")))
    floorplans(run)
    (row,) = rows_of(run)
    assert (row["plan_id"], row["origin"]) == ("a", "houseexpo")
    assert row["source"] == str(tmp_path / "plans" / "a.json")
    assert row["area_m2"] == pytest.approx(2 * 3.95 * 4 + 0.1 * 0.9)
    assert row["start_regions"] == 2
    read_back = plan_of(row)
    assert read_back.digest() == row["plan_digest"]
    assert to_houseexpo(read_back)["room_category"] == {"Bedroom": [[0, 0, 3.95, 4]]}


def test_a_file_a_folder_and_an_archive_hold_the_same_plans(make_run: MakeRun, tmp_path: Path):
    folder = write(tmp_path / "plans", a=plan("a"), b=plan("b", width_m=9.0), c=plan("c", width_m=10.0))
    packed = archive(tmp_path / "json.tar.gz", folder)
    ids = []
    for sources in ([folder], [packed], [folder / f"{name}.json" for name in "abc"]):
        run = read_run(make_run, *sources, data=str(tmp_path / f"data-{len(ids)}"))
        floorplans(run)
        ids.append([(row["plan_id"], row["plan_digest"]) for row in rows_of(run)])
    assert ids[0] == ids[1] == ids[2]
    assert [plan_id for plan_id, _ in ids[0]] == ["a", "b", "c"]


def peak_bytes(path: Path, files: int) -> int:
    """Memory that it takes to read an archive of so many files of 4 kB."""
    rng = random.Random(0)
    with tarfile.open(path, "w:gz", compresslevel=1) as tar:
        for index in range(files):
            entry = tarfile.TarInfo(f"json/{index:05d}.json")
            entry.size = 4000
            tar.addfile(entry, io.BytesIO(rng.randbytes(entry.size)))
    tracemalloc.start()
    assert sum(1 for _ in plan_files(str(path))) == files
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_an_archive_is_streamed_in_bounded_memory(tmp_path: Path):
    few, many = (peak_bytes(tmp_path / f"{count}.tar.gz", count) for count in (100, 2100))
    assert many - few < 100_000  # 50 bytes for each file of 4 kB


def test_a_truncated_archive_is_told(make_run: MakeRun, tmp_path: Path):
    folder = write(tmp_path / "plans", **{f"p{i}": plan(f"p{i}", width_m=8 + i) for i in range(9)})
    packed = archive(tmp_path / "json.tar.gz", folder)
    packed.write_bytes(packed.read_bytes()[:-300])
    with pytest.raises(FloorplanError, match=r"json.tar.gz: damaged after \d plans \(.*\); fetch it again"):
        floorplans(read_run(make_run, packed))


def test_any_flipped_byte_in_an_archive_is_told_or_does_no_harm(tmp_path: Path):
    folder = write(tmp_path / "plans", **{f"p{i}": plan(f"p{i}", width_m=8 + i) for i in range(3)})
    packed = archive(tmp_path / "json.tar.gz", folder)
    whole, sound = packed.read_bytes(), [file.content for file in plan_files(str(packed))]
    told = []
    for index in range(len(whole)):
        packed.write_bytes(whole[:index] + bytes([whole[index] ^ 0x55]) + whole[index + 1 :])
        try:
            assert [file.content for file in plan_files(str(packed))] == sound, f"byte {index}"
        except FloorplanError as error:
            told.append(str(error))
    assert len(told) > len(whole) - 30  # all but some of gzip's own header
    line = re.compile(r".*json.tar.gz: damaged after \d plans \(.+\); fetch it again")
    assert [message for message in told if not line.fullmatch(message)] == []


@pytest.mark.parametrize("harm", ["header", "no end"])
def test_a_damaged_archive_without_compression_is_told(tmp_path: Path, harm: str):
    packed = tmp_path / "json.tar"
    with tarfile.open(packed, "w", format=tarfile.USTAR_FORMAT) as tar:  # one header for each member
        tar.add(write(tmp_path / "plans", a=plan("a"), b=plan("b")), arcname="json")
    content = bytearray(packed.read_bytes())
    second = content.index(b"json/b.json")
    if harm == "header":
        content[second + 20] ^= 1
    else:
        del content[second:]
    packed.write_bytes(content)
    with pytest.raises(FloorplanError, match=r"json.tar: damaged after 1 plans \(.+\); fetch it again"):
        list(plan_files(str(packed)))


def test_what_cannot_be_used_is_left_out_with_its_reason(make_run: MakeRun, tmp_path: Path):
    bowtie = {"id": "bowtie", "verts": [[0, 0], [8, 8], [8, 0], [0, 8]]}
    folder = write(
        tmp_path / "plans",
        bowtie=bowtie,
        broken="{",
        deep="[" * 100_000,
        good=plan("good"),
        list=[1, 2],
        pixels=plan("pixels", width_m=800.0),
    )
    (folder / "binary.json").write_bytes(b"\xff\x00\xfe")
    run = read_run(make_run, folder)
    manifest = floorplans(run)
    assert [row["plan_id"] for row in rows_of(run)] == ["good"]
    reasons = {Path(entry.item_id).stem: entry.reason for entry in manifest.quarantined}
    assert set(reasons) == {"binary", "bowtie", "broken", "deep", "list", "pixels"}
    assert "crosses itself at (4.00, 4.00) m" in reasons["bowtie"]
    assert "not JSON" in reasons["broken"]
    assert "not JSON" in reasons["deep"]
    assert "one JSON object" in reasons["list"]
    assert "coordinates in metres" in reasons["pixels"]
    assert manifest.counts() == {"candidates": 7, "plans": 1}
    assert "1 of 7 plans are usable (14.3 %)" in said(run)
    assert f"left out {folder / 'broken.json'}: {folder / 'broken.json'}: not JSON" in said(run)


def test_a_file_far_too_large_for_a_plan_is_not_parsed(make_run: MakeRun, tmp_path: Path):
    folder = write(tmp_path / "plans", good=plan("good"))
    with (folder / "huge.json").open("wb") as file:
        file.truncate(16_000_001)
    for source in (folder, archive(tmp_path / "json.tar.gz", folder)):
        manifest = floorplans(read_run(make_run, source, data=str(tmp_path / f"data-{source.name}")))
        (entry,) = manifest.quarantined
        assert "16000001 bytes; a floor plan has at most 16000000" in entry.reason


def test_duplicates_are_left_out_across_sources(make_run: MakeRun, tmp_path: Path):
    first = write(tmp_path / "first", a=plan("a"), b=plan("b", width_m=9.0))
    second = write(
        tmp_path / "second", c=plan("a", width_m=10.0), d=plan("d"), e=plan("gen-000001", width_m=12.0)
    )
    run = read_run(make_run, first, second, generate=3)
    manifest = floorplans(run)
    assert [row["plan_id"] for row in rows_of(run)] == ["a", "b", "gen-000001", "gen-000000", "gen-000002"]
    reasons = {Path(entry.item_id).stem: entry.reason for entry in manifest.quarantined}
    assert set(reasons) == {"c", "d", "gen-000001"}
    for name in ("c", "d"):
        assert reasons[name].endswith(f"duplicate: same id or geometry as {first / 'a.json'}")
    assert reasons["gen-000001"].endswith(f"same id or geometry as {second / 'e.json'}")


def test_a_plan_that_cannot_be_used_shadows_none_that_can(make_run: MakeRun, tmp_path: Path):
    folder = write(
        tmp_path / "plans",
        a=plan("x", width_m=800.0),  # far too wide
        b=plan("x"),
        c=plan("bad id!", width_m=9.0),
        d=plan("y", width_m=9.0),  # the geometry of c
        e=plan("z"),  # the geometry of b
        f=plan("z", width_m=11.0),  # the id of e, which is a duplicate
        g=plan("gen-000000", width_m=900.0),
    )
    run = read_run(make_run, folder, generate=1)
    manifest = floorplans(run)
    assert [row["plan_id"] for row in rows_of(run)] == ["x", "y", "z", "gen-000000"]
    reasons = {Path(entry.item_id).stem: entry.reason for entry in manifest.quarantined}
    assert set(reasons) == {"a", "c", "e", "g"}
    assert reasons["e"].endswith(f"duplicate: same id or geometry as {folder / 'b.json'}")


def test_a_run_without_any_usable_plan_says_so(make_run: MakeRun, tmp_path: Path):
    run = read_run(make_run, write(tmp_path / "plans", broken="{", wide=plan("x", width_m=800.0)))
    with pytest.raises(FloorplanError, match=r"none of 2 floor plans is usable; the first: .*not JSON"):
        floorplans(run)
    assert re.search(r"left out .*wide\.json: ", " ".join(run.console.file.getvalue().split()))
    with pytest.raises(FloorplanError, match="none of 0 floor plans is usable"):
        floorplans(read_run(make_run, data=str(tmp_path / "other")))


@pytest.mark.parametrize(
    ("name", "message"), [("nowhere", "'.*nowhere' not found"), ("a.txt", "must end in")]
)
def test_a_source_that_is_none_is_a_config_error(make_run: MakeRun, tmp_path: Path, name: str, message: str):
    (tmp_path / "a.txt").write_text("")
    with pytest.raises(ConfigError, match=f"floorplans.sources: .*{message}"):
        floorplans(read_run(make_run, tmp_path / name))


def test_generated_plans_are_usable_and_keyed_by_the_seed(make_run: MakeRun, tmp_path: Path):
    digests = []
    for seed in (0, 1):
        run = read_run(make_run, generate=4, seed=seed, data=str(tmp_path / f"seed-{seed}"))
        floorplans(run)
        rows = rows_of(run)
        assert [row["plan_id"] for row in rows] == [f"gen-{index:06d}" for index in range(4)]
        assert {row["origin"] for row in rows} == {"generated"}
        for row in rows:
            assert validated(plan_of(row), robot_radius_m=RADIUS_M).digest() == row["plan_digest"]
            assert len(start_regions(plan_of(row), robot_radius_m=RADIUS_M)) == row["start_regions"] >= 2
        digests.append({row["plan_digest"] for row in rows})
    assert len(digests[0] | digests[1]) == 8


def test_more_generated_plans_leave_the_others_as_they_are(make_run: MakeRun, tmp_path: Path):
    source = write(tmp_path / "plans", a=plan("a"))
    floorplans(read_run(make_run, source, generate=2))
    run = read_run(make_run, source, generate=4)
    floorplans(run)
    assert "1 made, 2 kept" in said(run)


def test_kinds_that_came_later_are_in_what_a_shard_depends_on_only_where_they_are_drawn(
    make_run: MakeRun, tmp_path: Path
):
    """So that shards of earlier versions are kept."""
    for name, more, kinds in (
        ("plain", (), set()),
        ("mixed", ("floorplans.generate.plans.warehouse=0.5",), {"warehouse"}),
    ):
        generated = ("floorplans.sources=[]", "floorplans.generate.count=2")
        run = make_run((*generated, *more), data=str(tmp_path / name))
        floorplans(run)
        (shard,) = run.read("floorplans").shards()
        keys = {key.rpartition(".")[2] for key in shard.inputs.parameters}
        assert keys >= {"apartment", "office", "hall"}
        assert keys & {"large_hall", "warehouse"} == kinds


def test_a_source_more_leaves_the_shards_of_the_others_as_they_are(make_run: MakeRun, tmp_path: Path):
    first = write(tmp_path / "first", a=plan("a"), b=plan("b", width_m=9.0), c=plan("c", width_m=10.0))
    second = write(tmp_path / "second", d=plan("d", width_m=11.0))
    floorplans(read_run(make_run, first, generate=2))
    run = read_run(make_run, second, first, generate=2)
    floorplans(run)
    assert "1 made, 3 kept" in said(run)
    fresh = read_run(make_run, second, first, generate=2, data=str(tmp_path / "fresh"))
    floorplans(fresh)
    assert folder_content(run.folder("floorplans")) == folder_content(fresh.folder("floorplans"))


def test_an_edited_plan_rebuilds_its_own_shard_only(make_run: MakeRun, tmp_path: Path):
    source = write(tmp_path / "plans", a=plan("a"), b=plan("b", width_m=9.0), c=plan("c", width_m=10.0))
    floorplans(read_run(make_run, source))
    write(source, c=plan("c", width_m=10.5))
    run = read_run(make_run, source)
    floorplans(run)
    assert f"making part-00001.parquet again: upstream: {source / 'c.json'} changed" in said(run)
    assert "1 made, 1 kept" in said(run)


def test_a_limit_rebuilds_all_and_a_generator_parameter_only_what_is_generated(
    make_run: MakeRun, tmp_path: Path
):
    source = write(tmp_path / "plans", a=plan("a"))
    overrides = [f"floorplans.sources=[{source}]", "floorplans.generate.count=1"]
    floorplans(make_run(overrides))
    run = make_run([*overrides, "floorplans.generate.plans.loop_share=0.5"])
    floorplans(run)
    assert "floorplans.generate.plans.loop_share changed 0.25 -> 0.5" in said(run)
    assert "1 made, 1 kept" in said(run)
    run = make_run([*overrides, "floorplans.limits.min_area_m2=10.0"])
    floorplans(run)
    assert "2 made, 0 kept" in said(run)


def test_genuine_houseexpo_plans_are_usable(make_run: MakeRun, real_data: Path):
    run = read_run(make_run, real_data / "houseexpo")
    manifest = floorplans(run)
    assert manifest.counts() == {"candidates": 2, "plans": 2}
    assert {row["plan_id"][:4] for row in StageReader(run.folder("floorplans")).rows()} == {"0004", "0a1b"}


def test_the_number_of_shards_is_known_unless_a_source_is_an_archive(make_run: MakeRun):
    module = import_module("rendezvous.stages.floorplans")
    folder = ROOT / "floorplans"
    plans = len(list(folder.glob("*.json")))
    overrides = [
        "floorplans.plans_per_shard=2",
        "floorplans.generate.count=5",
        f"floorplans.sources=[{folder}]",
    ]
    section = make_run(overrides).config.floorplans
    # Each source has shards of its own: none mixes them.
    assert module._shard_count(section) == -(-plans // 2) + 3
    archive = make_run([*overrides[:2], "floorplans.sources=[plans.tar.gz]"]).config.floorplans
    assert module._shard_count(archive) is None
