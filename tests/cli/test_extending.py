"""Parts of an installed package: the page on them, followed line by line, and what it does not let through."""

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pytest
import torch

from lfref import OperatorRefocuser, extensions, load, shift_and_sum
from lfref.cli import parts
from lfref.data.label_sources import OperatorLabels
from lfref.errors import CheckpointError, InputError
from lfref.geometry import FocalPlanes
from lfref.train.modules import Refocusing
from tests.conftest import ROOT

BLOCKS = re.compile(r"```\w*\n# ([\w./]+)\n(.*?)```", re.DOTALL)
SMALL = (
    "net.n_planes=2",
    "slopes=[0,1]",
    "data.n_fields=1",
    "trainer.max_epochs=1",
    "~callbacks.progress",
    "~callbacks.summary",
    "~callbacks.pictures",
)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The folder of the page's package, and the folder that pip installed it into."""
    folder, site = tmp_path_factory.mktemp("lfref-extra"), tmp_path_factory.mktemp("site")
    for name, text in BLOCKS.findall((ROOT / "docs" / "extending.md").read_text()):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--disable-pip-version-check", "--target", str(site), str(folder)], check=True)
    return folder, site


@pytest.fixture
def installed(package, monkeypatch):
    """The package on the search path; what it changes in this process is undone."""
    folder, site = package
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv(extensions.VARIABLE, "")
    declared = extensions.declared
    declared.cache_clear()
    yield folder
    declared.cache_clear()
    sys.modules.pop("lfref_extra", None)


def test_the_page_trains_with_four_parts_of_a_package_and_loads_its_network(installed, lfref, tmp_path):
    run = tmp_path / "run"
    choices = ("net=one_layer", "data=few_scenes", "logger=json", "+metrics.largest._target_=lfref_extra.LargestError")
    words = ("--config-dir", installed / "choices", *choices, *SMALL, f"output={run}")
    status, errors = lfref("train", *words)
    assert status == 0, errors
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert any(0 < line.get("val/largest", 0) <= 1 for line in lines)
    with (run / "log" / "metrics.csv").open(newline="") as file:
        values = [row["val/largest"] for row in csv.DictReader(file) if row.get("val/largest")]
    assert len(values) == 1
    assert 0 < float(values[0]) <= 1
    refocuser = load(run)
    assert type(refocuser.network).__name__ == "OneLayer"
    assert refocuser(torch.rand(7, 7, 3, 24, 20)).shape == (2, 3, 24, 20)
    assert lfref("report", run, f"output={tmp_path}/report")[0] == 0
    assert "Other metrics that were logged" in next((tmp_path / "report").glob("*.html")).read_text()


def test_files_of_the_pages_own_source_become_batches(installed, tmp_path):
    import lfref_extra

    page = (ROOT / "docs" / "extending.md").read_text()
    (source,) = re.findall(r"```python\n(import numpy.*?)```", page, re.DOTALL)
    names = dict(vars(lfref_extra))
    exec(source, names)
    for seed in (0, 1):
        views = np.random.default_rng(seed).random((3, 3, 3, 40, 40), dtype=np.float32)
        np.savez(tmp_path / f"{seed}.npz", views=views)
    labels = OperatorLabels(OperatorRefocuser("sum", shift_and_sum), FocalPlanes([0.0, 1.0]))
    data = names["NpzData"](tmp_path, labels=labels, patch=16)
    data.setup("fit")
    batch = next(iter(data.train_dataloader()))
    assert batch["views"].shape == (4, 3, 3, 3, 16, 16)
    assert batch["labels"].shape == (4, 2, 3, 16, 16)
    assert next(iter(data.val_dataloader()))["where"][0].startswith("0@")


def test_a_checkpoint_of_a_package_that_is_not_installed_is_refused_in_one_line(installed, tmp_path, monkeypatch):
    from lfref_extra import OneLayer

    from lfref.nets import checkpoint

    checkpoint.save(tmp_path / "net.ckpt", OneLayer(2, (3, 3)), FocalPlanes([0.0, 1.0]))
    assert checkpoint.restore(tmp_path / "net.ckpt")[0].config["n_planes"] == 2
    monkeypatch.setattr(extensions, "declared", dict)
    with pytest.raises(CheckpointError, match="lfref --allow lfref_extra"):
        load(tmp_path / "net.ckpt")


@pytest.mark.parametrize(
    "name",
    [
        "lfref_extra.json.loads",
        "lfref_extra.pathlib.Path",
        "lfref_extra.Network",
        "lfref_extra.OneLayer.load_state_dict",
        "lfref_extra",
        "lfref_extra.Missing",
    ],
)
@pytest.mark.parametrize("is_allowed", [False, True])
def test_only_what_a_package_declares_or_defines_is_a_part(installed, name, is_allowed, monkeypatch):
    if is_allowed:
        extensions.allow("lfref_extra")
    with pytest.raises(InputError):
        parts.resolve(name)


def test_a_mistyped_part_of_a_package_is_answered_by_those_that_it_declares(installed):
    declared = "lfref_extra.FewScenes, lfref_extra.JsonLogger, lfref_extra.LargestError, lfref_extra.OneLayer"
    with pytest.raises(InputError, match=f"perhaps lfref_extra.OneLayer: lfref_extra declares {declared};"):
        parts.check({"_target_": "lfref_extra.OneLayr"})


def test_allow_lets_the_classes_of_a_package_through_without_entry_points(installed, monkeypatch):
    monkeypatch.setattr(extensions, "declared", dict)
    with pytest.raises(InputError, match="lfref --allow lfref_extra"):
        parts.check({"_target_": "lfref_extra.LargestError"})
    extensions.allow("lfref_extra")
    assert parts.build({"_target_": "lfref_extra.LargestError"}).largest == 0
    later = parts.build({"_target_": "lfref_extra.OneLayer", "_partial_": True, "n_planes": 1})
    assert later(grid=(3, 3)).n_planes == 1


@pytest.mark.parametrize("name", ["os", "subprocess", "torch", "lfref", "no_such_package", "lfref_extra.", "a b", ""])
def test_allow_takes_only_installed_packages_of_the_user(installed, name):
    with pytest.raises(InputError, match="--allow takes"):
        extensions.allow(name)


def test_allow_stands_anywhere_before_the_paths_and_only_on_the_command_line(installed, lfref, monkeypatch):
    status, errors = lfref("--allow", "os", "train")
    assert (status, len(errors.splitlines())) == (2, 1)
    status, errors = lfref("train", "--allow=lfref_extra", "net=no_such_net")
    assert status == 2
    assert extensions.allowed() == ["lfref_extra"]
    status, errors = lfref("train", "allow=lfref_extra")
    assert status == 2
    assert "every key must be one of this command" in errors


def test_loggers_of_a_package_write_into_the_run_folder_only(installed, tmp_path):
    run = tmp_path / "run"
    parts.check({"_target_": "lfref_extra.JsonLogger", "save_dir": str(run)}, run)
    for place in (tmp_path, "/", run / ".."):
        with pytest.raises(InputError, match="must lie in the run folder"):
            parts.check({"_target_": "lfref_extra.JsonLogger", "save_dir": str(place)}, run)


def test_a_part_that_does_not_fit_is_one_line(installed):
    with pytest.raises(InputError, match="the configuration must fit what it describes"):
        parts.build({"_target_": "lfref_extra.OneLayer", "no_such_option": 1})


def test_names_of_further_metrics_must_be_free():
    with pytest.raises(InputError, match="names of their own"):
        Refocusing(None, None, None, None, metrics={"loss": None})
