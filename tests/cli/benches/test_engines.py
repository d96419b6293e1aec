"""`lfref bench group=engines` leaves its tables and its picture, and the report shows them."""

import csv
import json

import pytest
import torch
from matplotlib.image import imread

from lfref.geometry import even_planes
from lfref.io import tensor_files
from lfref.nets import checkpoint
from lfref.nets.refiner import Refiner
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import networks
from lfref.refocuser.refocuser import OperatorRefocuser

SMALL = (
    "scene.camera.size=[64,72]", "calibration.scenes.camera.size=[48,48]", "calibration.n_fields=1", "n_scenes=1",
    "slopes=[-1,1]", "device=cpu", "passes.network=2", "passes.refiner=1", "engines=[channels_last,cuda_graphs]",
    "net.n_planes=2", "net.widths=[8]", "net.n_blocks=1", "net.stem_width=9",
)  # fmt: skip


def table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.fixture
def refiner(tmp_path):
    """The checkpoint of a refiner that does something."""
    network = Refiner(3, 1, width=8, n_blocks=1)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    entry = networks.refiner_entry(network, OperatorRefocuser("sum", shift_and_sum), ("central",))
    state = {checkpoint.PREFIX + name: value for name, value in network.state_dict().items()}
    tensor_files.write_checkpoint(tmp_path / "refiner.ckpt", {"lfref": entry, "state_dict": state})
    return tmp_path / "refiner.ckpt"


@pytest.mark.slow
def test_networks_without_training_are_measured_and_told_of_in_the_report(lfref, refiner, tmp_path):
    words = (*SMALL, f"refiner_checkpoint={refiner}")
    status, errors = lfref("bench", "group=engines", *words, f"output={tmp_path}/run")
    assert status == 0, errors
    folder = tmp_path / "run"
    rows = table(folder / "engines.csv")
    assert [row["network"] for row in rows] == ["refnet"] * 5 + ["refiner"] * 5
    engines = ["eager", "channels_last", "channels_last", "cuda_graphs", "cuda_graphs"]
    assert [row["engine"] for row in rows[:5]] == engines
    for row in rows:
        if row["engine"] == "cuda_graphs":
            assert row["skipped"] == "this engine runs on cuda; got cpu"
        else:
            assert float(row["min_s"]) > 0
            assert float(row["agreement_db"]) > 25
            assert (row["psnr_db"] == "") == (row["network"] == "refnet")
    assert len(table(folder / "passes.csv")) == 3 * 2 + 3 * 1
    assert json.loads((folder / "machine.json").read_text())["passes"] == {"network": 2, "refiner": 1}
    assert imread(folder / "engines.png").std() > 0.05
    assert lfref("report", f"output={tmp_path}/report", f"runs=[{folder}]")[0] == 0
    assert "<h2>Engines" in (tmp_path / "report" / "index.html").read_text()


def test_a_checkpoint_is_judged_by_truth_at_its_own_planes(lfref, tmp_path):
    network = RefNet(n_planes=2, widths=(8,), stem_width=8)
    checkpoint.save(tmp_path / "tiny.ckpt", network, even_planes(2))
    words = (*SMALL, "subjects=[network]", "precisions=[bf16]", f"checkpoint={tmp_path}/tiny.ckpt")
    status, errors = lfref("bench", "group=engines", *words, f"output={tmp_path}/run")
    assert status == 0, errors
    eager, bf16, _ = table(tmp_path / "run" / "engines.csv")
    assert (eager["precision"], bf16["precision"]) == ("fp32", "bf16")
    assert float(eager["loss_db"]) == 0
    assert float(eager["psnr_db"]) - float(bf16["psnr_db"]) == pytest.approx(float(bf16["loss_db"]), abs=1e-9)
    assert 0 < float(eager["psnr_db"]) < 40


def test_a_refiner_is_no_network_and_a_network_no_refiner(lfref, refiner, tmp_path):
    checkpoint.save(tmp_path / "tiny.ckpt", RefNet(n_planes=2, widths=(8,), stem_width=8), even_planes(2))
    for word, said in (
        (f"checkpoint={refiner}", "give refiner_checkpoint=RUN"),
        (f"refiner_checkpoint={tmp_path}/tiny.ckpt subjects=[refiner]", "give checkpoint=RUN"),
    ):
        status, errors = lfref("bench", "group=engines", *SMALL, *word.split(), f"output={tmp_path}/run")
        assert status != 0
        assert said in errors


def test_what_is_not_there_is_said_in_one_line(lfref, tmp_path):
    for word, said in (
        ("engines=[tensorrt]", "engine must be one of"),
        ("precisions=[fp4]", "precision must be one of fp32, bf16, int8"),
        ("subjects=[unet]", "subjects must be one of network, refiner"),
        ("subjects=[]", "subjects must be some of network, refiner; got none"),
        ("passes.network=0", "network must be a number of at least 1"),
    ):
        status, errors = lfref("bench", "group=engines", *SMALL, word, f"output={tmp_path}/run")
        assert status != 0
        assert said in errors
        assert "Traceback" not in errors
