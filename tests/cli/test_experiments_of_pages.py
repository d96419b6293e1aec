"""What the pages on the paper and on ablations train: every setup can be trained, and none is trained twice."""

import importlib
import sys

import pytest

from lfref.cli import train as command
from tests.cli.conftest import TINY, TINY_DATA
from tests.cli.test_experiments import FAST, losses, thinned  # noqa: F401  a fixture
from tests.conftest import ROOT

sys.path.append(str(ROOT / "docs"))
ablations, paper, training = (importlib.import_module(name) for name in ("ablations", "paper", "training"))


@pytest.mark.parametrize("variant", thinned(ablations.VARIANTS))
def test_every_variant_of_the_page_on_ablations_passes_a_fast_dev_run(composed, tmp_path, losses, variant):  # noqa: F811
    said = (*ablations.SETUP, *TINY_DATA, "net.stem_width=16", *ablations.VARIANTS[variant])
    config = composed("train", *said, *FAST)
    command.train(config, tmp_path)
    assert [bool(loss.isfinite()) for loss in losses] == [True]


def test_every_network_of_the_pages_has_a_folder_of_its_own_and_one_setup():
    experiment = paper.Experiment()
    wanted = list(experiment.trained()) + list(ablations.trained(ablations.RUNS))
    own = {folder for folder in wanted if wanted.count(folder) == 1}
    shared = set(wanted) - own
    assert len(own) == 3 * 3 + 3 * (len(ablations.VARIANTS) - 1)
    assert shared == set(experiment.folders["RefNet on truth"])
    for folder in shared:
        assert experiment.trained()[folder] == ablations.trained(ablations.RUNS)[folder]


@pytest.mark.slow
def test_what_is_trained_is_kept_and_what_was_stopped_goes_on(tmp_path):
    said = [*TINY, "trainer.max_epochs=2"]
    folder = tmp_path / "net"
    assert training.train({folder: [*said, "seed=1"]}) == {}
    last = folder / "checkpoints" / "last.ckpt"
    made = last.stat().st_mtime_ns
    training.train({folder: [*said, "seed=1"]})
    assert last.stat().st_mtime_ns == made
    with pytest.raises(SystemExit, match="seed=1 seed=2"):
        training.train({folder: [*said, "seed=2"]})
    assert last.stat().st_mtime_ns == made
    other = tmp_path / "other"
    failed = training.train({other: [*said, "net.activation=magic"], folder: [*said, "seed=1"]})
    assert list(failed) == [other]
    assert "activation must be one of" in failed[other]
