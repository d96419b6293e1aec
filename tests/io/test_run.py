"""A run folder: what a command wrote in it, and what a training left."""

import pytest

from lfref.errors import CheckpointError, FileError
from lfref.io.run import Run, run_name, write_overrides

METRICS = "epoch,step,val/mpsnr\n0,1,\n0,1,20.5\n1,3,20\n1,4,22\n1,3,21\n1,"
OVERRIDES = ["data.path='a b/c'", "net.widths=[8, 8]", "~callbacks.best"]


@pytest.fixture
def folder(tmp_path):
    """A run that was resumed at step 3."""
    folder = tmp_path / "my run"
    for part in ("checkpoints", "log"):
        (folder / part).mkdir(parents=True)
    (folder / "config.yaml").write_text("trainer: {max_epochs: 5, max_steps: -1}\n")
    write_overrides(folder, OVERRIDES)
    (folder / "checkpoints" / "last.ckpt").touch()
    (folder / "log" / "metrics.csv").write_text(METRICS)
    return folder


@pytest.mark.parametrize("part", ["", "checkpoints/last.ckpt"])
def test_a_run_is_found_by_its_folder_or_a_checkpoint_in_it(folder, part, monkeypatch):
    monkeypatch.chdir(folder)
    run = Run.of(f"../my run/{part}")
    assert (run.folder, run.name, run.chosen) == (folder, "my run", folder / part if part else None)
    assert run.last == folder / "checkpoints" / "last.ckpt"
    assert run.config["trainer"] == {"max_epochs": 5, "max_steps": -1}
    assert run.overrides == OVERRIDES


def test_metrics_leave_out_a_line_that_was_cut_off_and_steps_that_were_done_again(folder):
    assert [(row["step"], row["val/mpsnr"]) for row in Run(folder).metrics] == [(1, None), (1, 20.5), (3, 20), (3, 21)]


def test_the_last_checkpoint_is_the_best_one_where_there_is_no_other(folder):
    with pytest.raises(CheckpointError):
        _ = Run(folder).best
    (folder / "checkpoints" / "last.ckpt").rename(folder / "checkpoints" / "best.ckpt")
    assert Run(folder).last == Run(folder).best == folder / "checkpoints" / "best.ckpt"
    (folder / "checkpoints" / "best.ckpt").unlink()
    with pytest.raises(CheckpointError):
        _ = Run(folder).last


@pytest.mark.parametrize("path", ["nowhere", "my run/checkpoints/best.ckpt", "lone.ckpt"])
def test_what_is_no_run_is_one_clear_error(folder, path, one_line):
    (folder.parent / "lone.ckpt").touch()
    with pytest.raises(CheckpointError) as caught:
        Run.of(folder.parent / path)
    one_line(caught.value, path)


def test_a_file_that_is_missing_or_damaged_is_one_clear_error(folder):
    (folder / "config.yaml").write_text("a: [")
    (folder / "overrides.yaml").unlink()
    (folder / "log" / "metrics.csv").unlink()
    for name in ("config", "overrides", "metrics"):
        with pytest.raises(FileError):
            getattr(Run(folder), name)


@pytest.mark.parametrize(
    ("path", "name"), [("outputs/2026-11-21/checkpoints/best.ckpt", "2026-11-21"), ("models/paper.ckpt", "paper")]
)
def test_a_checkpoint_is_named_after_its_run(tmp_path, path, name):
    assert run_name(tmp_path / path) == name
