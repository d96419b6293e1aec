"""Commands run in this process, and configurations small enough for a test."""

import sys
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli import main as cli
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.train.modules import Refocusing

TINY_DATA = (
    "data=simulated",
    "scene.camera.size=[64,64]",
    "data.patch=32",
    "data.patches_per_field=1",
    "data.n_fields=2",
    "data.n_validation=1",
)
TINY_NET = ("net=refnet_small", "net.widths=[8,8]", "net.n_blocks=2", "net.stem_width=9")
TINY = (*TINY_DATA, *TINY_NET)


@pytest.fixture(autouse=True)
def is_no_job(monkeypatch):
    """Hydra keeps the configuration of its last job: a later test would take itself for a job of the same sweep."""
    monkeypatch.setattr(HydraConfig.instance(), "cfg", None)


@pytest.fixture
def captures(tmp_path):
    """A folder of three light fields, one of which cannot be read."""
    for name in ("first one", "second", "third"):
        write(tmp_path / "captures" / name, LightField(torch.rand(3, 3, 3, 32, 40)))
    view = tmp_path / "captures" / "second" / "second_01_01.png"
    view.write_bytes(view.read_bytes()[:-30])
    return tmp_path / "captures"


@pytest.fixture
def composed(tmp_path: Path):
    """Function (command, *overrides) -> its configuration, output in a temporary folder."""

    def make(command: str, *overrides: str) -> DictConfig:
        with initialize_config_dir(str(configs.directory()), version_base="1.3"):
            return compose(command, [f"output={tmp_path}", f"folder={tmp_path}", *overrides])

    return make


@pytest.fixture
def fits(monkeypatch) -> list[tuple[float, int]]:
    """Rate and first epoch of every training that starts in this process."""
    started = []

    def watch(self):
        started.append((self.trainer.optimizers[0].param_groups[0]["lr"], self.trainer.current_epoch))

    monkeypatch.setattr(Refocusing, "on_train_start", watch)
    return started


@pytest.fixture
def lfref(monkeypatch, capfd, tmp_path):
    """Function (*words) -> (exit status, standard error) of the console script, run in this process."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["lfref", *map(str, words)])
        status = 0
        try:
            cli.main()
        except SystemExit as leaving:
            status = leaving.code
        return status, capfd.readouterr().err

    return run
