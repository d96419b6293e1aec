import pytest
import torch
import yaml

from lfref.errors import CheckpointError, FileError
from lfref.io.run import Run, run_name, write_overrides

METRICS = "epoch,step,val/mpsnr\n0,1,\n0,1,20.5\n1,3,21\n1,"


def checkpoint(epochs: int, steps: int) -> dict:
    progress = {"current": {"processed": epochs}}
    return {"loops": {"fit_loop": {"epoch_progress": progress}}, "global_step": steps, "optimizer_states": []}


@pytest.fixture
def folder(tmp_path):
    """A run that has done 3 of its 5 epochs."""
    folder = tmp_path / "my run"
    for part in ("checkpoints", "log", "pictures"):
        (folder / part).mkdir(parents=True)
    (folder / "config.yaml").write_text("trainer: {max_epochs: 5, max_steps: -1}\n")
    write_overrides(folder, ["data.path='a b/c'", "net.widths=[8, 8]", "~callbacks.best"])
    torch.save(checkpoint(3, 30), folder / "checkpoints" / "last.ckpt")
    (folder / "log" / "metrics.csv").write_text(METRICS)
    for name in ("epoch_0001.png", "epoch_0000.png"):
        (folder / "pictures" / name).touch()
    return folder


@pytest.mark.parametrize("before", ["", "../my run/../"])
@pytest.mark.parametrize("part", ["", "checkpoints/last.ckpt"])
def test_a_run_is_found_by_its_folder_or_a_checkpoint_in_it(folder, before, part, monkeypatch):
    monkeypatch.chdir(folder if before else folder.parent)
    run = Run.of(f"{before}my run/{part}")
    assert (run.folder, run.name) == (folder, "my run")
    assert run.chosen == (folder / part if part else None)
    assert run.last == folder / "checkpoints" / "last.ckpt"
    assert run.config["trainer"] == {"max_epochs": 5, "max_steps": -1}
    assert run.overrides == ["data.path='a b/c'", "net.widths=[8, 8]", "~callbacks.best"]
    assert [path.name for path in run.pictures] == ["epoch_0000.png", "epoch_0001.png"]


def test_metrics_are_rows_of_numbers_and_a_line_that_was_cut_off_is_left_out(folder):
    assert [(row["epoch"], row["val/mpsnr"]) for row in Run.of(folder).metrics] == [(0, None), (0, 20.5), (1, 21)]


@pytest.mark.parametrize(
    ("settings", "is_finished"),
    [
        ({"max_epochs": 3}, True),
        ({"max_epochs": 4}, False),
        ({"max_epochs": -1, "max_steps": 30}, True),
        ({"max_epochs": None, "max_steps": -1}, False),
    ],
)
def test_a_run_is_finished_when_it_has_the_epochs_or_steps_it_was_set_to(folder, settings, is_finished):
    (folder / "config.yaml").write_text(yaml.safe_dump({"trainer": settings}))
    assert Run.of(folder).is_finished is is_finished


def test_a_training_that_ended_early_by_its_own_rule_is_finished(folder):
    (folder / "training.json").write_text('{"is_finished": false}')
    assert not Run.of(folder).is_finished
    (folder / "training.json").write_text('{"is_finished": true}')
    assert Run.of(folder).is_finished


def test_a_training_without_notes_has_neither_size_nor_failure(folder):
    assert (Run(folder).training, Run(folder).failure) == ({}, {})
    (folder / ".lfref_failure.json").write_text('{"overrides": [], "reason": "disk full"}')
    assert Run(folder).failure["reason"] == "disk full"
    (folder / "training.json").write_text("{")
    with pytest.raises(FileError, match=r"training\.json must be JSON"):
        _ = Run(folder).training


def test_overrides_of_an_older_run_are_read_from_one_line(folder):
    (folder / "overrides.yaml").unlink()
    line = "+sweep=a net.widths=[8, 8] ~callbacks.best data.path='a b/c d' +method@methods.x=shift_and_sum ++net.x=1\n"
    (folder / "overrides.txt").write_text(line)
    assert Run.of(folder).overrides == [
        "+sweep=a", "net.widths=[8, 8]", "~callbacks.best", "data.path='a b/c d'", "+method@methods.x=shift_and_sum",
        "++net.x=1",
    ]  # fmt: skip
    assert Run.of(folder).title == line.strip()
    (folder / "overrides.txt").unlink()
    assert Run.of(folder).title == "my run"


@pytest.mark.parametrize(
    ("path", "error", "message"),
    [
        ("nowhere", FileError, "nowhere must be a run folder or a checkpoint in one; got no .*config.yaml"),
        ("my run/checkpoints/best.ckpt", CheckpointError, "no checkpoint at .*best.ckpt; give a run folder"),
        ("lone.ckpt", CheckpointError, "lone.ckpt must be a run folder or a checkpoint in one"),
    ],
)
def test_what_is_no_run_is_one_clear_error(folder, path, error, message):
    (folder.parent / "lone.ckpt").touch()
    with pytest.raises(error, match=message):
        Run.of(folder.parent / path)


def test_the_best_checkpoint_is_the_last_where_there_is_no_other(folder):
    (folder / "checkpoints" / "last.ckpt").rename(folder / "checkpoints" / "best.ckpt")
    assert Run.of(folder).last == folder / "checkpoints" / "best.ckpt"
    (folder / "checkpoints" / "best.ckpt").unlink()
    with pytest.raises(CheckpointError, match=r"run my run must have checkpoints/last\.ckpt; got none"):
        _ = Run.of(folder).last


def test_what_is_missing_in_a_run_is_named(folder):
    run = Run.of(folder)
    with pytest.raises(CheckpointError, match=r"run my run must have checkpoints/best\.ckpt; got last\.ckpt"):
        _ = run.best
    (folder / "overrides.yaml").unlink()
    with pytest.raises(FileError, match=r"overrides\.yaml cannot be read"):
        _ = run.overrides
    (folder / "log" / "metrics.csv").unlink()
    with pytest.raises(FileError, match=r"metrics\.csv cannot be read"):
        _ = run.metrics


@pytest.mark.parametrize("text", ["a: [", "- 1", "", "\x00"])
def test_a_damaged_configuration_is_one_clear_error(folder, text):
    (folder / "config.yaml").write_text(text)
    with pytest.raises(FileError, match=r"config\.yaml must (be YAML|hold a dict)"):
        _ = Run.of(folder).config


def test_a_checkpoint_without_training_or_damaged_is_no_finished_run(folder):
    torch.save({"lfref": {}, "state_dict": {}}, folder / "checkpoints" / "last.ckpt")
    with pytest.raises(CheckpointError, match="no training to resume"):
        _ = Run.of(folder).is_finished
    (folder / "checkpoints" / "last.ckpt").write_bytes(b"half")
    with pytest.raises(CheckpointError, match="damaged"):
        _ = Run.of(folder).is_finished


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("outputs/train/2026-11-21/checkpoints/best.ckpt", "2026-11-21"),
        ("models/paper.ckpt", "paper"),
        ("checkpoints.ckpt", "checkpoints"),
    ],
)
def test_a_checkpoint_is_named_after_its_run(tmp_path, path, name):
    assert run_name(tmp_path / path) == name


def test_a_run_is_in_its_folder_however_the_path_is_written(folder, monkeypatch):
    monkeypatch.chdir(folder)
    run = Run.of(folder)
    assert all(run.is_in(path) for path in (folder, str(folder), ".", f"../{folder.name}", folder / "log" / ".."))
    assert not run.is_in(folder.parent)
