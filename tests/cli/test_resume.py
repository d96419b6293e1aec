"""`lfref train resume=RUN`: the run's own configuration, but for what is said anew."""

import copy
import csv
import shutil

import pytest
import torch
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser

from lfref.cli import config as configs
from lfref.cli import resume
from lfref.errors import CheckpointError, InputError
from lfref.io.run import Run, key_of, write_overrides
from tests.cli.conftest import TINY
from tests.cli.test_bad_input import assert_one_line

QUIET = ("callbacks.progress=null", "callbacks.summary=null", "trainer.log_every_n_steps=1")
CHOICES = ("label=fourier_slice", "planes.convention=parallel", "loss.weights.beta=0.2", "scheduler=cosine")


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    return tmp_path_factory.mktemp("runs of one")


@pytest.fixture
def trained(lfref, workplace, tmp_path):
    """A copy of a run of two epochs, made once for all tests of this file; so it also was moved."""
    if not (workplace / "run").exists():
        where = resume.quoted(workplace / "run")
        status, error = lfref("train", f"output={where}", *TINY, *QUIET, *CHOICES, "trainer.max_epochs=2")
        assert status == 0, error
    return shutil.copytree(workplace / "run", tmp_path / "a run")


def logged(run, column="val/mpsnr"):
    with (run / "log" / "metrics.csv").open() as file:
        return [(int(row["epoch"]), float(row[column])) for row in csv.DictReader(file) if row[column]]


def score(checkpoint):
    callbacks = torch.load(checkpoint, weights_only=True)["callbacks"]
    return next(state["best_model_score"] for name, state in callbacks.items() if name.startswith("Best"))


def test_a_run_goes_on_as_it_was_set_up(lfref, trained):
    before, first, best = Run.of(trained).config, logged(trained), score(trained / "checkpoints" / "last.ckpt")
    status, error = lfref("train", f"resume={trained}", "trainer.max_epochs=3", "optimizer.lr=0.5")
    assert status == 0, error
    after = Run.of(trained).config
    # A task names all others, the rate and its schedule too.
    kept = set(resume.PROTECTED) - {"task"}
    assert {key: after.get(key) for key in kept} == {key: before.get(key) for key in kept}
    assert after["task"]["_target_"] == before["task"]["_target_"]
    assert (after["label"]["planes"]["convention"], after["loss"]["weights"]["beta"]) == ("parallel", 0.2)
    rows = logged(trained)
    assert rows[:2] == first
    assert [epoch for epoch, _ in rows] == [0, 1, 2]
    last = torch.load(trained / "checkpoints" / "last.ckpt", weights_only=True)
    assert last["lfref"]["planes"]["convention"] == "parallel"
    # The third of three epochs of a cosine, at the rate that was set anew.
    assert last["lr_schedulers"][0]["base_lrs"] == [0.5, 0.025]
    assert last["lr_schedulers"][0]["T_max"] == 3
    assert score(trained / "checkpoints" / "last.ckpt") == max(best, rows[2][1])


def test_a_run_that_is_trained_already_says_so_and_stays_as_it_is(lfref, trained):
    files = {
        path: path.stat().st_mtime_ns for path in trained.rglob("*") if path.name != "train.log" and path.is_file()
    }
    status, _ = lfref("train", f"resume={trained}")
    assert status == 0
    assert "is trained already; trainer.max_epochs=MORE goes on with it" in (trained / "train.log").read_text()
    assert all(path.stat().st_mtime_ns == time for path, time in files.items())


@pytest.mark.parametrize(
    ("override", "change"),
    [
        ("planes.convention=ng", r"planes\.convention \(parallel -> ng\)"),
        ("label=shift_and_sum", r"label\.refocuser\.name \(fourier_slice -> shift_and_sum\)"),
        ("loss.weights.beta=0.5", r"loss\.weights\.beta \(0\.2 -> 0\.5\)"),
        ("net.activation=relu", r"net\.activation \(softplus -> relu\)"),
        ("data.patch=16", r"data\.patch \(32 -> 16\)"),
        ("seed=3", r"seed \(0 -> 3\)"),
    ],
)
def test_a_change_of_what_is_learned_is_refused_by_name(composed, trained, override, change):
    run = Run.of(trained)
    old = [each for each in run.overrides if key_of(each) not in {"output", key_of(override)}]
    with pytest.raises(InputError, match=rf"run a run must go on with what .*{change}.*; .* allow_changes=true"):
        resume.refuse_changes(run, configs.plain(composed("train", *old, override)))


def test_length_rate_places_and_data_processes_may_change(composed, trained):
    run = Run.of(trained)
    old = [each for each in run.overrides if not each.startswith(("output", "trainer.max_epochs"))]
    new = ("trainer.max_epochs=9", "optimizer.lr=1", "data.workers=2", "data.timeout=3")
    resume.refuse_changes(run, configs.plain(composed("train", *old, *new)))


def test_where_a_version_keeps_the_code_is_no_change(trained):
    run = Run.of(trained)
    before = run.config
    earlier = copy.deepcopy(before)
    earlier["net"]["_target_"] = "lfref.networks.RefNet"
    earlier["planes"]["_target_"] = "lfref.geometry.FocalPlanes"
    del earlier["task"]
    earlier["data"]["an_option_that_is_gone"] = 1
    (trained / "config.yaml").write_text(yaml.safe_dump(earlier))
    resume.refuse_changes(run, before)
    earlier["net"]["_target_"] = "lfref.nets.other.OtherNet"
    (trained / "config.yaml").write_text(yaml.safe_dump(earlier))
    with pytest.raises(InputError, match=r"net\._target_ \(lfref\.nets\.other\.OtherNet -> .*RefNet\)"):
        resume.refuse_changes(run, before)


@pytest.mark.parametrize(
    ("override", "change"),
    [
        ("+scene.sensor.noise={_target_: lfref.simulator.effects.noise.Noise}", "scene.sensor.noise (None -> "),
        ("~net.activation", "net.activation (softplus -> None)"),
    ],
)
def test_a_setting_that_is_added_or_left_out_is_a_change_too(lfref, trained, override, change):
    status, error = lfref("train", f"resume={trained}", "trainer.max_epochs=9", override)
    assert status == 1
    assert f"run a run must go on with what it was trained on; got {change}" in error
    assert Run.of(trained).config["trainer"]["max_epochs"] != 9


@pytest.mark.slow
def test_a_refused_change_leaves_the_run_as_it_was_and_a_forced_one_is_taken(lfref, trained):
    before = copy.deepcopy(Run.of(trained).config)
    words = ("train", f"resume={trained}", "trainer.max_epochs=3", "loss.weights.beta=0.5")
    for _ in range(2):
        status, error = lfref(*words)
        assert status == 1
        assert error.count("\n") == 1
        assert Run.of(trained).config == before
    assert lfref(*words, "allow_changes=true")[0] == 0
    assert Run.of(trained).config["loss"]["weights"]["beta"] == 0.5


def test_a_run_that_goes_on_elsewhere_takes_its_log_and_its_best_along(lfref, trained, tmp_path):
    before = logged(trained)
    checkpoint = trained / "checkpoints" / "last.ckpt"
    assert lfref("train", f"resume={checkpoint}", f"output={tmp_path}/more", "trainer.max_epochs=3")[0] == 0
    assert logged(trained) == before
    assert [epoch for epoch, _ in logged(tmp_path / "more")] == [0, 1, 2]
    assert (tmp_path / "more" / "checkpoints" / "best.ckpt").is_file()
    status, error = lfref("train", f"resume={checkpoint}", f"output={tmp_path}/more", "trainer.max_epochs=3")
    assert status == 1
    assert "output must be a new or an empty folder" in error


def test_training_over_a_trained_run_is_refused(lfref, trained):
    status, error = lfref("train", f"output={resume.quoted(trained)}", *TINY)
    assert status == 1
    assert "output must be a new or an empty folder" in error
    assert Run.of(trained).config["trainer"]["max_epochs"] == 2


@pytest.fixture
def run(tmp_path):
    """A run as far as its command line goes."""
    folder = tmp_path / "it's a run"
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "config.yaml").write_text("{}")
    (folder / "checkpoints" / "last.ckpt").touch()
    write_overrides(folder, ["output=old", "net=refnet_small", "+a.b=1", "scheduler=cosine", "~callbacks.best"])
    return folder


def test_resume_becomes_the_runs_own_overrides_and_those_that_are_said_anew(run):
    line = resume.expanded([f"resume={run}", "scheduler=constant", "++a.b=2", "--cfg", "job"])
    new = ["scheduler=constant", "++a.b=2", "--cfg", "job"]
    last = f"resume={resume.quoted(run / 'checkpoints' / 'last.ckpt')}"
    assert line == ["net=refnet_small", "~callbacks.best", f"output={resume.quoted(run)}", *new, last]
    assert resume.expanded(line) == line


@pytest.mark.parametrize(
    "override",
    ["hydra.run.dir=/x", "data.cache_folder=/x", "logger=wandb", "logger@logger.b=wandb", "logger.csv.save_dir=/x",
     "callbacks.pictures.folder=/x", "trainer.default_root_dir=/x", "folder=/x", "overwrite=true", "hydra/launcher=x",
     "+hydra/job_logging=none", "logger/csv=wandb", "data={cache_folder: /x}", "+callbacks.x={a: [{dirpath: /x}]}"],
)  # fmt: skip
def test_a_run_folder_does_not_say_where_things_go(run, capsys, override):
    write_overrides(run, ["net=refnet_small", override])
    line = resume.expanded([f"resume={run}"])
    assert override not in line
    assert "net=refnet_small" in line
    assert override.startswith("folder") or override in capsys.readouterr().err
    assert override in resume.expanded([f"resume={run}", override])


@pytest.mark.parametrize(
    "entry", ["--config-dir=/x", "--multirun", "-m", "a b", " hydra.run.dir=/x", 3, {"a": 1}, None, ["a=1"]]
)
def test_a_run_folder_holds_no_options_of_the_command_line(run, entry):
    (run / "overrides.yaml").write_text(yaml.safe_dump(["net=refnet_small", entry]))
    with pytest.raises(InputError, match=r"overrides\.yaml must hold overrides KEY=VALUE"):
        resume.expanded([f"resume={run}"])


@pytest.mark.parametrize("name", ["plain", "it's", "a b, [c]={d}", "tail\\'s", '"x"', "(1)"])
def test_a_quoted_path_is_what_hydra_reads(tmp_path, name):
    (override,) = OverridesParser.create().parse_overrides([f"output={resume.quoted(tmp_path / name)}"])
    assert override.value() == str(tmp_path / name)


def test_a_line_that_resumes_nothing_stays_as_it_is():
    assert resume.expanded(["experiment=demo", "resume=null"]) == ["experiment=demo", "resume=null"]


def test_what_cannot_be_resumed_is_one_clear_error(run):
    with pytest.raises(InputError, match="goes on with one run, not with a sweep"):
        resume.expanded(["-m", f"resume={run}"])
    (run / "checkpoints" / "last.ckpt").unlink()
    with pytest.raises(CheckpointError, match=r"must have checkpoints/last\.ckpt; got none"):
        resume.expanded([f"resume={run}"])


@pytest.mark.parametrize("mark", [None, '{"kind": "run", "files": {}}'])
def test_a_run_that_goes_on_elsewhere_leaves_the_folder_of_somebody_else_alone(lfref, trained, tmp_path, mark):
    folder = tmp_path / "mine"
    (folder / "log").mkdir(parents=True)
    for name in ("config.yaml", "overrides.yaml", "log/metrics.csv"):
        (folder / name).write_text("mine")
    if mark is not None:
        (folder / ".lfref.json").write_text(mark)
    status, error = lfref("train", f"resume={trained}", f"output={folder}", "trainer.max_epochs=3")
    assert status == 1
    assert "output must be a new or an empty folder" in error
    assert [(folder / name).read_text() for name in ("config.yaml", "overrides.yaml", "log/metrics.csv")] == [
        "mine"
    ] * 3


def test_results_go_on_in_the_folder_of_their_run_only(lfref, tmp_path):
    words = ("simulate", "outputs=[views]", "scene.camera.size=[64,72]")
    assert lfref(*words, "n_fields=1", f"output={tmp_path}/run")[0] == 0
    line = assert_one_line(*lfref("simulate", f"resume={tmp_path}/run", f"output={tmp_path}/new"))
    expected = f"results go on in the folder of the run; got output={tmp_path}/new; leave output out"
    assert expected in line
    assert not list((tmp_path / "new").glob("simulated*"))
    for output in ("run", "run/", "./run"):
        status, error = lfref("simulate", "resume=run", f"output={output}")
        assert status == 0, error


def test_one_command_begins_a_run_and_goes_on_with_it(lfref, tmp_path):
    words = ("train", f"output={tmp_path}/run", "resume=auto", *TINY, *QUIET)
    for n_epochs in (1, 2):
        status, error = lfref(*words, f"trainer.max_epochs={n_epochs}")
        assert status == 0, error
    assert [epoch for epoch, _ in logged(tmp_path / "run")] == [0, 1]
    assert lfref(*words, "trainer.max_epochs=2")[0] == 0
    assert [epoch for epoch, _ in logged(tmp_path / "run")] == [0, 1]


def test_a_run_to_go_on_with_by_itself_needs_a_folder(run):
    with pytest.raises(InputError, match=r"resume=auto goes on in output, which must be given.*add output=RUN"):
        resume.expanded(["resume=auto", "experiment=demo"])
    assert resume.expanded(["resume=auto", "output=none", "seed=1"]) == ["output=none", "seed=1"]
    line = resume.expanded(["resume=auto", f"output={run}"])
    assert line[-1].startswith("resume=")
    assert line[-1].endswith(".ckpt'")
