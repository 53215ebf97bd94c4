"""`stages.yaml` and what is said of faults in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from rendezvous.config.load import load_config
from rendezvous.config.sections import Parameters
from rendezvous.config.stage_table import DATASET_STAGES, STAGES
from rendezvous.errors import ConfigError
from tests.conftest import ROOT

STAGES_YAML = ROOT / "stages.yaml"


@pytest.fixture
def edited(tmp_path: Path):
    """Writes `stages.yaml` with one piece of text replaced, and gives its path."""

    def edit(old: str, new: str) -> Path:
        text = STAGES_YAML.read_text()
        assert text.count(old) >= 1, f"{old!r} is not in stages.yaml"
        path = tmp_path / "edited.yaml"
        path.write_text(text.replace(old, new, 1))
        return path

    return edit


def message_of(*overrides: str, path: Path = STAGES_YAML, preset: str = "default") -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(path, preset=preset, overrides=overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("preset", ["smoke", "default", "large", "paper"])
def test_every_preset_loads(preset: str):
    assert load_config(STAGES_YAML, preset=preset).floorplans.generate.count > 0


def test_a_stage_is_named_in_one_table_that_file_parameters_and_modules_follow():
    file = load_config(STAGES_YAML).stages
    assert list(file) == list(STAGES) == [name for name in Parameters.model_fields if name != "seed"]
    assert {name: stage.reads for name, stage in file.items()} == {n: s.reads for n, s in STAGES.items()}
    modules = {path.stem: path for path in (ROOT / "pipeline" / "rendezvous" / "stages").glob("*.py")}
    assert modules.keys() == {*STAGES, "__init__"}
    assert all(f"\ndef {name}(run: Run" in modules[name].read_text() for name in STAGES)


def test_a_dataset_is_made_by_the_stages_up_to_pack():
    assert DATASET_STAGES == ("floorplans", "meshes", "explore", "render", "pack")


def test_a_preset_overrides_the_parameters_and_set_overrides_both():
    def plans(*overrides: str) -> int:
        return load_config(STAGES_YAML, preset="large", overrides=overrides).floorplans.generate.count

    assert plans() > load_config(STAGES_YAML).floorplans.generate.count
    assert plans("floorplans.generate.count=7") == 7
    assert plans("floorplans.generate.count=7", "floorplans.generate.count=8") == 8


def test_an_override_leaves_its_neighbours_alone():
    config = load_config(STAGES_YAML, overrides=["floorplans.generate.plans.rooms=[4, 6]"])
    assert config.floorplans.generate.plans.rooms == (4, 6)
    assert config.floorplans.generate.count == load_config(STAGES_YAML).floorplans.generate.count


@pytest.mark.parametrize("seed", [0, 1, 2**40, 2**63 - 1])
def test_the_seed_given_is_the_seed_used(seed: int):
    assert load_config(STAGES_YAML, overrides=["seed=5"], seed=seed).seed == seed
    assert load_config(STAGES_YAML, overrides=[f"seed={seed}"]).seed == seed


def test_values_are_yaml():
    config = load_config(
        STAGES_YAML, overrides=["meshes.wall_height_m=25e-1", "floorplans.sources=[a.json, b]"]
    )
    assert config.meshes.wall_height_m == 2.5
    assert config.floorplans.sources == ("a.json", "b")


def test_parameters_are_told_by_their_full_keys_without_those_left_out():
    section = load_config(STAGES_YAML).floorplans
    told = section.parameters(exclude={"sources", "generate.count", "limits"})
    assert told["floorplans.generate.plans.rooms"] == [3, 20]
    assert "floorplans.generate.count" not in told
    assert not any(key.startswith("floorplans.limits") for key in told)
    assert "floorplans.sources" not in told


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "explore.episode_per_plan=3",
            "unknown key 'explore.episode_per_plan'; the nearest known key is 'explore.episodes_per_plan'",
        ),
        (
            "floorplans.generate.plans.romms=[3, 4]",
            "unknown key 'floorplans.generate.plans.romms'; the nearest known key is "
            "'floorplans.generate.plans.rooms'",
        ),
        ("floorplan.sources=[]", "unknown key 'floorplan'; the nearest known key is 'floorplans'"),
        ("explore.episode.lidar_noise={}", "is gone; it is now lidar.noise of the robot file"),
        (
            "explore.episode.slam.mapping.no_echo_free_m=2.0",
            "key 'explore.episode.slam.mapping.no_echo_free_m' is gone; it is now lidar.no_echo_free_m of",
        ),
        ("explore.start_clearance_m=0.2", "it is now explore.start_margin_m, which is added to"),
        (
            "floorplans.limits.robot_radius_m=0.2",
            "it is now radius_m of the robot file that floorplans.robot",
        ),
        ("meshes.zzz=1", "unknown key 'meshes.zzz'; known keys are wall_height_m"),
        ("explore.episodes_per_plan=0", "explore.episodes_per_plan is 0; must be greater than or equal to 1"),
        ("explore.episodes_per_plan=yes", "explore.episodes_per_plan is True; must be a valid integer"),
        ("explore.episodes_per_plan='3'", "explore.episodes_per_plan is '3'; must be a valid integer"),
        ("meshes.wall_height_m=.inf", "meshes.wall_height_m is inf; must be a finite number"),
        ("meshes.wall_height_m=2024-01-01", "must be numbers, texts, lists and mappings"),
        ("train.settings={width: .nan}", "train.settings is {'width': nan}; must hold finite numbers"),
        ("train_pose.settings.width=.inf", "train_pose.settings is {'width': inf}; must hold finite"),
        (f"floorplans.plans_per_shard={10**30}", "must be less than or equal to 1000000000"),
        ("seed=-1", "seed is -1; must be greater than or equal to 0"),
        (f"seed={2**63}", f"seed is {2**63}; must be less than or equal to {2**63 - 1}"),
        ("seed=2024-13-45", "month must be in 1..12"),
        ("explore={[1]: 2}", "[1] cannot be a key"),
        ("meshes.robot=" + "[" * 10_000, "nested more than 40 levels deep"),
        ("explore.episodes_per_plan", "must be KEY=VALUE, such as explore.episodes_per_plan=10"),
        ("explore..x=1", "must be KEY=VALUE"),
        ("explore.episodes_per_plan=[", "expected the node content"),
        ("explore=3", "explore is 3; must be an object"),
    ],
)
def test_a_wrong_override_is_told_with_key_value_and_what_is_right(override: str, said: str):
    message = message_of(override)
    assert said in message
    assert override[:80] in message or "texts, lists" in message


def test_a_rooms_own_contract_is_a_config_error():
    assert "rooms is (1, 2); must be (least, most)" in message_of("floorplans.generate.plans.rooms=[1, 2]")


def test_a_training_has_an_end():
    assert "train_pose.minutes and train_pose.samples are both null" in message_of("train_pose.minutes=null")
    bounded = load_config(STAGES_YAML, overrides=["train.minutes=null", "train.samples=8"])
    assert (bounded.train.minutes, bounded.train.samples) == (None, 8)


def test_splits_share_no_more_plans_than_there_are():
    assert "validation_fraction and pack.test_fraction: sum to 1.1; must be at most 1" in message_of(
        "pack={validation_fraction: 0.4, test_fraction: 0.7}"
    )
    whole = load_config(STAGES_YAML, overrides=["pack={validation_fraction: 0.3, test_fraction: 0.7}"])
    assert whole.pack.test_fraction == 0.7


def test_a_fault_names_the_layer_that_it_is_in(edited):
    in_stage = edited("wall_height_m: 2.5", "wall_height_m: high")
    assert message_of(path=in_stage).startswith(
        f"{in_stage}: stages: meshes.wall_height_m is 'high'; must be"
    )
    in_preset = edited("\npresets:\n", "\npresets:\n  mine: {explore: {episodes_per_plam: 1}}\n")
    said = f"{in_preset}: presets.mine: unknown key 'explore.episodes_per_plam'"
    assert message_of(path=in_preset, preset="mine").startswith(said)


def test_unknown_keys_around_the_parameters_are_faults_too(edited):
    assert "the nearest known key is 'stages.meshes.reads'" in message_of(
        path=edited("reads: [floorplans]", "read: [floorplans]")
    )
    assert "the nearest known key is 'presets'" in message_of(path=edited("presets:", "preset:"))


def test_a_missing_parameter_is_named(edited):
    message = message_of(path=edited("      wall_height_m: 2.5\n", ""))
    assert "key 'meshes.wall_height_m' is missing" in message


def test_a_key_given_twice_is_a_fault_with_its_line(edited):
    path = edited("wall_height_m: 2.5", "wall_height_m: 2.5\n      wall_height_m: 3.5")
    line = path.read_text().splitlines().index("      wall_height_m: 3.5") + 1
    assert message_of(path=path) == f"{path}:{line}: key 'wall_height_m' is given twice"


def test_yaml_cannot_run_code(edited, tmp_path: Path):
    mark = tmp_path / "mark"
    path = edited("seed: 0", f"seed: !!python/object/apply:os.system ['touch {mark}']")
    assert "could not determine a constructor" in message_of(path=path)
    assert not mark.exists()


def test_a_stage_cannot_read_what_comes_after_it(tmp_path: Path):
    content = yaml.safe_load(STAGES_YAML.read_text())
    content["stages"] = dict(reversed(content["stages"].items()))
    path = tmp_path / "reversed.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    assert "stages.train_pose.reads has 'pack'; the stages above it are none" in message_of(path=path)


@pytest.mark.parametrize("reads", ["[]", "[explore]", "[floorplans, explore]"])
def test_a_stage_reads_what_its_code_reads(edited, reads: str):
    message = message_of(path=edited("reads: [floorplans]", f"reads: {reads}"))
    given = [name for name in re.split(r"\W+", reads) if name]
    assert f"stages.meshes.reads is {given}; must be ['floorplans']" in message


def test_the_configuration_knows_what_each_stages_code_reads():
    stages = load_config(STAGES_YAML).stages
    assert stages.keys() == STAGES.keys()
    for stage in stages:
        code = (ROOT / "pipeline" / "rendezvous" / "stages" / f"{stage}.py").read_text()
        assert set(re.findall(r'run\.read\("(\w+)"\)', code)) == set(STAGES[stage].reads)


@pytest.mark.parametrize(
    "writes", ["", ".", "..", "a/b", "../floorplans", "/tmp", "a b", ".hidden", "Meshes"]
)
def test_a_stages_folder_has_a_plain_name(edited, writes: str):
    message = message_of(path=edited("writes: meshes", f"writes: {writes!r}"))
    assert f"stages.meshes.writes is {writes!r}; must be one folder's plain name" in message


def test_no_two_stages_write_to_one_folder(edited):
    message = message_of(path=edited("writes: meshes", "writes: floorplans"))
    assert "stages.meshes.writes is 'floorplans', as is floorplans's; each stage needs its own" in message


def test_runs_of_both_trainings_share_a_folder_beside_the_data():
    stages = load_config(STAGES_YAML).stages
    assert stages["train"].writes == stages["train_pose"].writes == "runs"


def test_a_sections_keys_begin_with_its_stages_name():
    config = load_config(STAGES_YAML)
    for stage in config.stages:
        section = getattr(config, stage)
        assert section.stage() == stage
        assert all(key.startswith(f"{stage}.") for key in section.parameters())


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"- 1", b"a\x00b"])
def test_a_file_that_is_no_mapping_in_text_is_one_line(tmp_path: Path, content: bytes):
    path = tmp_path / "stages.yaml"
    path.write_bytes(content)
    message = message_of(path=path)
    assert message.startswith(f"{path}: ")
    assert content == b"a\x00b" or "must be a YAML mapping with seed, stages and presets" in message


def test_a_seed_on_the_command_line_is_told_as_such():
    with pytest.raises(ConfigError, match=r"^--seed 9{20}: seed is 9{20}; must be less than or equal to"):
        load_config(STAGES_YAML, seed=int("9" * 20))


def test_a_missing_file_and_an_unknown_preset_are_told():
    assert "no such file" in message_of(path=Path("nowhere.yaml"))
    assert message_of(preset="big").endswith(
        "no preset 'big'; presets are smoke, default, poses, maps, pathtraced, large, paper"
    )
