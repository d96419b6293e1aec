"""One folder a run, never taken from another unasked."""

import errno
import fcntl
import os
import subprocess
import sys
import time

import pytest
import torch

from lfref.cli import run_folder
from lfref.errors import FileError
from lfref.io import ownership, write
from lfref.io.run import write_overrides
from lfref.lightfield import LightField


def run(folder, **files):
    """A run that writes files."""
    run_folder.claim(folder)
    with run_folder.marked(folder):
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)


def names(folder):
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != run_folder.LOCK)
    return sorted(path.relative_to(folder).as_posix() for path in files)


def test_a_new_and_an_empty_folder_are_free(tmp_path):
    run_folder.claim(tmp_path / "new" / "er")
    run_folder.claim(tmp_path / "new" / "er")
    assert names(tmp_path) == []


def test_a_stopped_run_of_several_results_is_told_how_it_goes_on(tmp_path):
    run(tmp_path / "run", **{"a.exr": "x", ".hydra/overrides.yaml": "[]"})
    write_overrides(tmp_path / "run", [])
    with pytest.raises(FileError, match=r"go on by resume=.*/run, choose another, or give overwrite=true, which"):
        run_folder.claim(tmp_path / "run", goes_on=True)


def test_a_folder_with_results_is_refused(tmp_path):
    run(tmp_path / "run", **{"stack.exr": "x"})
    with pytest.raises(FileError, match=r"new or an empty folder; got .*run; .*overwrite=true"):
        run_folder.claim(tmp_path / "run")


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_somebody_else_is_refused(tmp_path, overwrite):
    (tmp_path / "config.yaml").write_text("mine")
    with pytest.raises(FileError, match="choose another"):
        run_folder.claim(tmp_path, overwrite)
    assert names(tmp_path) == ["config.yaml"]


def test_a_run_that_failed_before_its_results_leaves_a_free_folder(tmp_path):
    run(tmp_path, **{"config.yaml": "x", "overrides.yaml": "x", "refocus.log": "x"})
    run_folder.claim(tmp_path)
    assert (tmp_path / run_folder.LOCK).is_file()


def test_a_run_that_was_refused_before_it_marked_the_folder_leaves_a_free_folder(tmp_path):
    run_folder.claim(tmp_path)
    (tmp_path / "refocus.log").touch()
    run_folder.claim(tmp_path)
    (tmp_path / "config.yaml").write_text("mine")
    with pytest.raises(FileError, match="choose another"):
        run_folder.claim(tmp_path)


def test_a_folder_with_a_log_of_somebody_else_is_refused(tmp_path):
    (tmp_path / "refocus.log").touch()
    with pytest.raises(FileError, match="choose another"):
        run_folder.claim(tmp_path)


def test_a_refused_configuration_leaves_a_free_folder(lfref, tmp_path):
    small = ("scene=plane", "scene.camera.size=[24,24]", "scene.camera.grid=[3,3]", "outputs=[views]", "output=out")
    status, error = lfref("simulate", *small, "scene._target_=lfref.simulator.scene.Scenes")
    assert (status, "_target_ must be a part" in error) == (1, True)
    assert (tmp_path / "out" / "simulate.log").exists()
    assert lfref("simulate", *small)[0] == 0


def test_overwriting_deletes_what_the_run_wrote_and_nothing_else(tmp_path):
    run(tmp_path, **{"config.yaml": "x", "planes/a.png": "x", "kept/b.png": "x"})
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "kept" / "mine.txt").write_text("mine")
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK, "kept/mine.txt", "notes.txt"]
    assert not (tmp_path / "planes").exists()
    with run_folder.marked(tmp_path):
        (tmp_path / "new.png").write_text("x")
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK, "kept/mine.txt", "notes.txt"]


def test_a_run_that_ends_early_still_lists_what_it_wrote(tmp_path):
    def broken():
        with run_folder.marked(tmp_path):
            (tmp_path / "half.png").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken()
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK]


def test_what_a_killed_run_listed_is_its_own_and_nothing_else(tmp_path):
    run_folder.claim(tmp_path)
    marked = run_folder.marked(tmp_path)
    marked.__enter__()
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "stack.exr").write_text("x")
    run_folder.list_also(tmp_path, tmp_path / "one")  # and here it is killed
    with run_folder.marked(tmp_path):
        (tmp_path / "three.png").write_text("x")
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK, "two/stack.exr"]


@pytest.mark.parametrize("kind", [None, "views"])
def test_without_a_mark_of_a_run_only_the_part_is_listed(kind, tmp_path):
    if kind is not None:
        ownership.write_mark(tmp_path, kind, {"view.png": "0"})
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "stack.exr").write_text("x")
    run_folder.list_also(tmp_path, tmp_path / "one")
    assert ownership.read_mark(tmp_path).files.keys() == {"one/stack.exr"}


@pytest.mark.parametrize("content", ["{", "[]", '{"files": 3}', "{}"])
def test_a_damaged_mark_deletes_nothing(tmp_path, content):
    (tmp_path / ownership.MARK).write_text(content)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(FileError, match="choose another output"):
        run_folder.claim(tmp_path, overwrite=True)
    assert "mine.txt" in names(tmp_path)


def test_a_mark_that_leads_elsewhere_is_not_followed(tmp_path):
    folder, outside = tmp_path / "run", tmp_path / "outside"
    outside.mkdir()
    (outside / "mine.txt").write_text("mine")
    run(folder)
    (folder / "link").symlink_to(outside)
    (folder / "file").symlink_to(outside / "mine.txt")
    listed = '{"files": ["../outside/mine.txt", "link/mine.txt", "file", "%s"]}' % (outside / "mine.txt")
    (folder / ownership.MARK).write_text(listed)
    run_folder.claim(folder, overwrite=True)
    assert (outside / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("edit", [False, True])
def test_a_light_field_that_lfref_wrote_is_no_run_and_stays(tmp_path, edit):
    capture = write.write(tmp_path / "capture", LightField(torch.rand(5, 5, 3, 4, 4)))
    if edit:
        (capture / "capture_02_02.png").write_bytes(b"painted over")
    before = names(tmp_path)
    with pytest.raises(FileError, match=r"run folder of lfref.*got a folder of views; choose another output"):
        run_folder.claim(capture, overwrite=True)
    assert names(tmp_path) == before
    assert len(before) == 26


def test_a_run_with_an_edited_file_is_not_overwritten_but_its_log_may_have_grown(tmp_path):
    run(tmp_path, **{"plane/view.png": "x", "refocus.log": "x"})
    (tmp_path / "refocus.log").write_text("x and more")
    (tmp_path / "plane" / "view.png").write_text("painted over")
    before = names(tmp_path)
    with pytest.raises(FileError, match=r"got plane/view.png, edited; choose another output"):
        run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == before
    (tmp_path / "plane" / "view.png").write_text("x")
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK]


def test_a_file_edited_between_two_runs_becomes_the_users(tmp_path):
    run(tmp_path, **{"a.png": "x", "b.png": "x"})
    (tmp_path / "a.png").write_text("painted over")
    with run_folder.marked(tmp_path):
        (tmp_path / "c.png").write_text("x")
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK, "a.png"]


def test_marks_of_older_runs_which_list_names_alone_still_count(tmp_path):
    for name in ("a.png", "mine.txt"):
        (tmp_path / name).write_text("x")
    (tmp_path / ownership.MARK).write_text('{"written_by": "lfref", "files": ["a.png", "gone.png"]}')
    run_folder.claim(tmp_path, overwrite=True)
    assert names(tmp_path) == [ownership.MARK, "mine.txt"]


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="folder that can be written"):
        run_folder.make(tmp_path / "file" / "run")


def test_a_commands_output_is_refused_and_replaced_when_asked(lfref, tmp_path):
    words = [
        "simulate",
        "scene=plane",
        "scene.camera.size=[24,24]",
        "scene.camera.grid=[3,3]",
        f"output={tmp_path}/out",
    ]
    assert lfref(*words, "outputs=[disparity]")[0] == 0
    (tmp_path / "out" / "notes.txt").write_text("mine")
    status, error = lfref(*words, "outputs=[views]")
    assert status == 1
    assert error.startswith("lfref simulate: output must be a new or an empty folder")
    assert (tmp_path / "out" / "disparity" / "plane.exr").exists()
    assert lfref(*words, "outputs=[views]", "overwrite=true")[0] == 0
    assert not (tmp_path / "out" / "disparity").exists()
    assert (tmp_path / "out" / "plane").is_dir()
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("words", [["train"], ["simulate", "--multirun", "seed=1,2"]])
def test_training_and_sweeps_are_never_overwritten(lfref, tmp_path, words):
    status, error = lfref(*words, "overwrite=true", f"output={tmp_path}/out")
    assert status == 1
    assert "overwrite must be false for training, for sweeps" in error


@pytest.mark.parametrize("overwrite", ["false", "true"])
def test_an_output_that_is_or_contains_an_input_is_refused_and_nothing_changes(lfref, tmp_path, overwrite):
    assert lfref("simulate", "n_fields=1", "scene.camera.size=[64,72]", "outputs=[views]", "output=made")[0] == 0
    before = ownership.files_below(tmp_path / "made")
    (field,) = (path for path in (tmp_path / "made").iterdir() if path.is_dir() and path.name.startswith("simulated"))
    (tmp_path / "caps [1]").mkdir()
    (tmp_path / "caps [1]" / "made").symlink_to(tmp_path / "made")
    for source, output in (
        (field, field), (field, "made"), ("made/simulated*", "made"), ("made/*", tmp_path), ("caps [1]/made/*", "made"),
    ):  # fmt: skip
        status, errors = lfref("refocus", source, "slopes=[0]", f"output={output}", f"overwrite={overwrite}")
        assert status != 0
        assert "output must be a folder that neither is nor contains an input" in errors
    assert ownership.files_below(tmp_path / "made") == before


def test_a_training_without_a_checkpoint_starts_anew_by_the_same_line(tmp_path):
    run(tmp_path, **{"overrides.yaml": "[a=1]", "log/metrics.csv": "x"})
    with pytest.raises(FileError, match="new or an empty folder"):
        run_folder.claim(tmp_path, overrides=["a=2"])
    run_folder.claim(tmp_path, overrides=["a=1"])
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "last.ckpt").touch()
    with pytest.raises(FileError, match="resume="):
        run_folder.claim(tmp_path, overrides=["a=1"])


def test_of_processes_that_start_into_one_folder_at_once_one_wins(tmp_path):
    code = "import sys, time, pathlib; from lfref.cli import run_folder; run_folder.claim(pathlib.Path(sys.argv[1])); "
    command = [sys.executable, "-c", code + "print('mine', flush=True); time.sleep(60)", str(tmp_path / "run")]
    starts = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(4)]
    try:
        while sum(start.poll() is None for start in starts) > 1:
            time.sleep(0.1)
        (winner,) = (start for start in starts if start.poll() is None)
        assert winner.stdout.readline() == "mine\n"
        losers = [start.communicate()[1] for start in starts if start is not winner]
        assert all("no other run writes into" in error for error in losers)
    finally:
        for start in starts:
            start.kill()
            start.communicate()
    run_folder.claim(tmp_path / "run")  # the system has unlocked it


def test_a_disk_without_locks_is_one_line(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    run_folder.unlock()  # of the test before
    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(FileError, match=r"files can be locked; got .*No locks available"):
        run_folder.claim(tmp_path / "run")


def test_a_refused_folder_keeps_no_lock_file(tmp_path):
    (tmp_path / "mine.txt").touch()
    with pytest.raises(FileError):
        run_folder.claim(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_processes_of_one_training_make_their_folder_at_the_same_time(tmp_path):
    code = "import sys; from lfref.cli.run_folder import make; from pathlib import Path\n"
    code += f"for _ in range(1000): make(Path({str(tmp_path)!r}))"
    processes = [subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) for _ in range(3)]
    assert [process.communicate()[1] for process in processes] == 3 * [b""]
