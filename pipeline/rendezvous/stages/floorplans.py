"""Read and generate floor plans; keep those that two robots can explore."""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice

from rendezvous.config.sections import FloorplansSection
from rendezvous.engine.run import Run, Task, part_name
from rendezvous.errors import FloorplanError
from rendezvous.floorplan.generate import LATER_KINDS, GeneratorParameters, generate_floorplan
from rendezvous.floorplan.houseexpo import parse_floorplan
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.validate import start_regions, validated
from rendezvous.interop.houseexpo_files import (
    PlanFile,
    check_source,
    count_plan_files,
    parsed_json,
    plan_files,
)
from rendezvous.plan_schema import FLOORPLANS, PLAN_COLUMNS, plan_row
from rendezvous.robot_file import load_robot
from rendezvous.seeds import stream
from rendezvous.store.records import Inputs, Manifest, Quarantined, Shard
from rendezvous.store.tables import Layout, column_types

VERSION = 1
LAYOUT = Layout(item_column="plan_id", identity=PLAN_COLUMNS)
REASONS_SHOWN = 10  # reasons for leaving plans out that are printed; the manifest holds all

Judge = Callable[[Floorplan], Floorplan]  # gives the plan repaired, or raises `FloorplanError`


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A floor plan that may be usable."""

    name: str  # its file, or its id if it is generated
    origin: str
    digest: str  # SHA-256 of the file; '' for a generated plan, which parameters and seed determine
    load: Callable[[], Floorplan]  # gives the plan, or raises `FloorplanError`
    keys: tuple[str, ...]  # its id and geometry, none of which two plans may share
    same_as: str = ""  # an earlier, usable candidate that shares one


def floorplans(run: Run) -> Manifest:
    """Write every usable floor plan of the sources, then those that are generated.

    Raises:
        FloorplanError: a source is missing, or no plan is usable.
    """
    section = run.config.floorplans
    robot_radius_m = load_robot(section.robot).radius_m
    judge = partial(validated, robot_radius_m=robot_radius_m, limits=section.limits)
    for source in section.sources:
        check_source(source)
    batches = _batches(section, run.config.seed, robot_radius_m, judge)
    tasks = (
        Task(name=part_name(index), inputs=inputs, make=partial(usable_plans, batch, judge, robot_radius_m))
        for index, (inputs, batch) in enumerate(batches)
    )
    manifest = run.build("floorplans", tasks, layout=LAYOUT, total=_shard_count(section))
    _report_acceptance(run, manifest)
    return manifest


def usable_plans(candidates: Iterable[Candidate], judge: Judge, robot_radius_m: float) -> Shard:
    """The usable candidates, repaired; the others are quarantined with the reason."""
    rows, quarantined = [], []
    for candidate in candidates:
        try:
            if candidate.same_as:
                raise FloorplanError(
                    f"{candidate.name}: duplicate: same id or geometry as {candidate.same_as}"
                )
            plan = judge(candidate.load())
        except FloorplanError as error:
            quarantined.append(Quarantined(item_id=candidate.name, reason=str(error), where=candidate.origin))
            continue
        rows.append(
            {
                **plan_row(plan),
                "origin": candidate.origin,
                "source": candidate.name,
                "area_m2": plan.free_space().area,
                "start_regions": len(start_regions(plan, robot_radius_m=robot_radius_m)),
            }
        )
    counts = {"candidates": len(rows) + len(quarantined), "plans": len(rows)}
    return Shard(table=FLOORPLANS.table(rows), counts=counts, quarantined=tuple(quarantined))


def _batches(
    section: FloorplansSection, seed: int, robot_radius_m: float, judge: Judge
) -> Iterator[tuple[Inputs, tuple[Candidate, ...]]]:
    """The candidates of each shard. None mixes sources: a new source leaves the others' shards alone."""
    holders: dict[str, Candidate] = {}
    robot = {"floorplans.robot.radius_m": robot_radius_m}
    judged_by = section.parameters(exclude={"sources", "generate", "plans_per_shard", "robot"}) | robot
    weights = section.generate.plans.weights()
    unused = {f"generate.plans.{kind}" for kind in LATER_KINDS if weights[kind] == 0.0}
    left_out = {"sources", "generate.count", "plans_per_shard", "robot"} | unused
    drawn_from = section.parameters(exclude=left_out) | robot
    read = [(_read_candidates(source), judged_by, None) for source in section.sources]
    generated = (_generated_candidates(section, seed, robot_radius_m), drawn_from, seed)
    for candidates, parameters, own_seed in [*read, generated]:
        marked = _marked_duplicates(candidates, holders, judge)
        while batch := tuple(islice(marked, section.plans_per_shard)):
            inputs = Inputs(
                parameters=parameters,
                columns=column_types(FLOORPLANS.arrow()),
                items={candidate.name: candidate.same_as or candidate.digest for candidate in batch},
                seed=own_seed,
                version=VERSION,
            )
            yield inputs, batch


def _read_candidates(source: str) -> Iterator[Candidate]:
    for file in plan_files(source):
        yield Candidate(
            name=file.source,
            origin="houseexpo",
            digest=hashlib.sha256(file.content).hexdigest(),
            load=partial(_parsed, file.source, zlib.compress(file.content, level=1), file.fault),
            keys=_keys(file),
        )


def _generated_candidates(
    section: FloorplansSection, seed: int, robot_radius_m: float
) -> Iterator[Candidate]:
    for index in range(section.generate.count):
        plan_id = f"gen-{index:06d}"
        yield Candidate(
            name=plan_id,
            origin="generated",
            digest="",
            load=partial(_generated, plan_id, section.generate.plans, seed, robot_radius_m),
            keys=(f"id {plan_id}",),
        )


def _generated(plan_id: str, parameters: GeneratorParameters, seed: int, robot_radius_m: float) -> Floorplan:
    rng = stream(seed, "floorplans", plan_id)
    return generate_floorplan(rng, plan_id=plan_id, robot_radius_m=robot_radius_m, parameters=parameters)


def _parsed(source: str, compressed: bytes, fault: str) -> Floorplan:
    """The plan in a file. Its content is held compressed, because duplicates are sought among all files."""
    if fault:
        raise FloorplanError(f"{source}: {fault}")
    return parse_floorplan(parsed_json(zlib.decompress(compressed), source), source=source)


def _keys(file: PlanFile) -> tuple[str, ...]:
    """The plan's id and geometry as the file gives them; () if the file is faulty."""
    try:
        data = parsed_json(file.content, file.source)
    except FloorplanError:
        return ()
    if not isinstance(data, dict) or "id" not in data or "verts" not in data:
        return ()
    rings = json.dumps([data["verts"], data.get("holes", [])])
    return f"id {data['id']}", f"geometry {hashlib.sha256(rings.encode()).hexdigest()}"


def _marked_duplicates(
    candidates: Iterable[Candidate], holders: dict[str, Candidate], judge: Judge
) -> Iterator[Candidate]:
    """The candidates, each with the earlier usable one that it duplicates.

    Only a candidate whose key comes up again is judged here; all others are judged in their shards.

    `holders` has, by each key, the latest candidate that is no known duplicate; it is updated in place.
    """

    @cache
    def usable(candidate: Candidate) -> bool:
        try:
            judge(candidate.load())
        except FloorplanError:
            return False
        return True

    for candidate in candidates:
        rivals = [holders[key] for key in candidate.keys if key in holders]
        first = next((rival.name for rival in rivals if usable(rival)), "")
        if not first:
            holders |= dict.fromkeys(candidate.keys, candidate)
        yield replace(candidate, same_as=first)


def _shard_count(section: FloorplansSection) -> int | None:
    counts = [count_plan_files(source) for source in section.sources]
    known = [count for count in counts if count is not None]
    if len(known) < len(counts):
        return None
    return sum(math.ceil(count / section.plans_per_shard) for count in [*known, section.generate.count])


def _report_acceptance(run: Run, manifest: Manifest) -> None:
    candidates, plans = manifest.counts().get("candidates", 0), manifest.rows
    for entry in manifest.quarantined[:REASONS_SHOWN]:
        run.say(f"floorplans: left out {entry.item_id}: {entry.reason}")
    if len(manifest.quarantined) > REASONS_SHOWN:
        more = len(manifest.quarantined) - REASONS_SHOWN
        run.say(
            f"floorplans: left out {more} more; all reasons are in {run.folder('floorplans')}/manifest.json"
        )
    if not plans:
        first = f"; the first: {manifest.quarantined[0].reason}" if manifest.quarantined else ""
        raise FloorplanError(f"none of {candidates} floor plans is usable{first}")
    run.say(f"floorplans: {plans} of {candidates} plans are usable ({100 * plans / candidates:.1f} %)")
