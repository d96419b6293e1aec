"""Commands one after the other, as people run them: simulate, train, refocus, eval, bench, report."""

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.encoding import SRGB
from lfref.io import tensor_files
from lfref.io.read import SAMPLE, read, read_stack
from lfref.io.run import Run
from lfref.nets import checkpoint
from lfref.refocus import apertures
from lfref.refocus.focus.all_in_focus import extended_focus
from lfref.refocus.shift.shift_and_median import shift_and_median
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.report import answers
from lfref.report.tables import read_table
from tests.cli.conftest import TINY
from tests.export import cases

QUICK = (*TINY, "trainer.max_epochs=2", "trainer.log_every_n_steps=1")


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture
def trained(lfref, workplace):
    """A trained run and simulated scenes, made once for all tests of this file."""
    if not (workplace / "scenes").exists():
        assert lfref("simulate", f"output={workplace}/scenes", "n_fields=2", "scene.camera.size=[64,72]")[0] == 0
        assert lfref("train", f"output={workplace}/run", *QUICK)[0] == 0
    return workplace


def test_train_leaves_config_checkpoints_metrics_and_pictures(trained):
    run = Run(trained / "run")
    assert run.config["trainer"]["max_epochs"] == 2
    assert run.best.is_file()
    assert torch.load(run.last, weights_only=True)["epoch"] == 1
    assert len([row for row in run.metrics if row["val/mpsnr"]]) == 2
    assert len(list((run.folder / "pictures").glob("*.png"))) == 2


def test_refocus_writes_the_stack_through_an_aperture_and_a_picture_sharp_everywhere(lfref, trained, tmp_path):
    field = trained / "scenes" / "simulated_s0_e0_000"
    words = ("method=shift_and_sum", "aperture=disc", "aperture.diameter=3", "alphas=[0.5,1,2]")
    assert lfref("refocus", field, *words, "exposure=1", "all_in_focus=true", f"output={tmp_path}/out")[0] == 0
    stack, planes = read_stack(tmp_path / "out" / "stack.exr")
    assert planes.alphas == (0.5, 1.0, 2.0)
    views = read(field).views
    torch.testing.assert_close(stack, shift_and_sum(views, planes.slopes, weights=apertures.disc((7, 7), 3)))
    sharp = extended_focus(views).clamp(0, 1)
    for name, light in (("planes/plane_01_slope_0_alpha_1", stack[1]), ("all_in_focus", sharp)):
        shown = OpenImageIO.ImageBuf(str(tmp_path / "out" / f"{name}.png")).get_pixels("float")
        assert abs(torch.from_numpy(shown) - SRGB.encode(light).permute(1, 2, 0)).max() <= 0.5 / 255 + 1e-6


def test_the_sample_that_ships_is_refocused_at_once(lfref, tmp_path):
    assert lfref("refocus", "sample", "method=shift_and_sum", "slopes=[-1,0.45]", f"output={tmp_path}/out")[0] == 0
    stack, field = read_stack(tmp_path / "out" / "stack.exr")[0], read(SAMPLE)
    torch.testing.assert_close(stack, shift_and_sum(field.views, [-1, 0.45]))
    assert sum(file.stat().st_size for file in SAMPLE.iterdir()) < 2e6


@pytest.mark.parametrize(
    "method", ["shift_and_sum_antialiased", "fourier_slice", "separable_wiener", "blockwise_wiener"]
)
def test_bands_of_a_spectral_camera_pass_through_and_pictures_show_three(lfref, trained, tmp_path, method):
    colours = read(trained / "scenes" / "simulated_s0_e0_000").views
    bands = torch.cat([colours, 0.5 * colours, 0.25 * colours], 2)
    np.save(tmp_path / "a.npy", bands.numpy())
    words = ("reader.axes=vuchw", f"method={method}", "slopes=[0.4,-0.8]", "exposure=1", "correct=none")
    assert lfref("refocus", tmp_path / "a.npy", *words, f"output={tmp_path}/out")[0] == 0
    stack = read_stack(tmp_path / "out" / "stack.exr")[0]
    assert stack.shape == (2, 9, *colours.shape[-2:])
    torch.testing.assert_close(stack[:, 3:6], stack[:, :3] / 2, atol=0.01, rtol=0)
    shown = OpenImageIO.ImageBuf(str(next((tmp_path / "out" / "planes").iterdir()))).get_pixels("float")
    means = [SRGB.encode(stack[0, first : first + 3].mean(0).clamp(0, 1)) for first in (6, 3, 0)]
    assert abs(torch.from_numpy(shown) - torch.stack(means, -1)).max() <= 0.5 / 255 + 1e-6


def test_refocus_by_the_median_of_the_views(lfref, trained, tmp_path):
    field = trained / "scenes" / "simulated_s0_e0_000"
    assert lfref("refocus", field, "combine=median", "slopes=[0.4]", f"output={tmp_path}/out")[0] == 0
    torch.testing.assert_close(
        read_stack(tmp_path / "out" / "stack.exr")[0], shift_and_median(read(field).views, [0.4])
    )
    status, error = lfref("refocus", field, "method=fourier_slice", "combine=median", f"output={tmp_path}/no")
    assert (status, "median of fourier_slice" in error) == (1, True)


def test_refocus_by_the_f_number_of_a_lens_that_the_file_states(lfref, trained, tmp_path):
    field = trained / "scenes" / "simulated_s0_e0_000"
    status, error = lfref("refocus", field, "aperture.f_number=8", f"output={tmp_path}/no")
    assert (status, "states the f-number" in error) == (1, True)
    views = read(field).views
    spec = OpenImageIO.ImageSpec(72 * 14, 64 * 14, 3, "uint8")
    spec.attribute("FNumber", 2.0)
    eslf = torch.nn.functional.pad(views, (0, 0) * 3 + (4, 3, 4, 3)).permute(3, 0, 4, 1, 2).reshape(64 * 14, 72 * 14, 3)
    buffer = OpenImageIO.ImageBuf(spec)
    buffer.set_pixels(spec.roi, SRGB.encode(eslf).numpy())
    buffer.write(str(tmp_path / "a.tif"))
    words = ("reader.lenslet=14", "slopes=[0.4]", "method=shift_and_sum", "correct=none")
    assert lfref("refocus", tmp_path / "a.tif", "aperture.f_number=8", *words, f"output={tmp_path}/out")[0] == 0
    stack, expected = read_stack(tmp_path / "out" / "stack.exr")[0], apertures.disc((7, 7), 14 * 2 / 8)
    views = read(tmp_path / "a.tif", lenslet=14).views
    torch.testing.assert_close(stack, shift_and_sum(views, [0.4], weights=expected))
    status, error = lfref("refocus", tmp_path / "a.tif", "aperture.f_number=2", *words, f"output={tmp_path}/no")
    assert (status, "must be at least 4" in error) == (1, True)


def test_refocus_by_a_checkpoint_makes_its_planes(lfref, trained, tmp_path):
    field = trained / "scenes" / "simulated_s0_e0_000"
    assert lfref("refocus", f"input={field}", f"run={trained}/run", f"output={tmp_path}/out")[0] == 0
    stack, planes = read_stack(tmp_path / "out" / "stack.exr")
    assert stack.shape == (16, 3, 64, 72)
    assert planes.alphas[0] == 0.125
    for words in ("alphas=[1]", "aperture=disc"):  # a network has planes and an aperture of its own
        status, error = lfref("refocus", f"input={field}", f"run={trained}/run", words, f"output={tmp_path}/no")
        assert status == 1, error


def test_a_network_brings_its_planes_its_grid_and_the_encoding_of_its_samples(lfref, trained, tmp_path):
    network = cases.network().network
    entry = checkpoint.payload(network, cases.PLANES, is_linear=False)
    state = {f"net.{name}": value for name, value in network.state_dict().items()}
    tensor_files.write_checkpoint(tmp_path / "net.ckpt", {"lfref": entry, "state_dict": state})
    words = (f"input={trained}/scenes/simulated_s0_e0_000", f"checkpoint={tmp_path}/net.ckpt")
    for command in ("eval", "refocus", "view"):
        status, error = lfref(command, *words, f"output={tmp_path}/{command}")
        assert status == 0, error
    assert len(read_table(tmp_path / "eval" / "planes.csv")) == 3 * 2 * len(cases.PLANES)


def test_eval_writes_every_plane_and_the_means_and_the_report_shows_them(lfref, trained):
    words = (f"input={trained}/scenes", f"run={trained}/run", "+method@methods.s=shift_and_sum")
    assert lfref("eval", f"output={trained}/eval", *words)[0] == 0
    planes, summary = (read_table(trained / "eval" / f"{name}.csv") for name in ("planes", "summary"))
    assert len(planes) == 2 * 4 * 2 * 16
    kinds = dict(zip(summary["method"], summary["is_network"], strict=True))
    classical = ("shift_and_sum_antialiased", "mean_of_views", "shift_and_sum")
    assert kinds == {"run": True} | dict.fromkeys(classical, False)
    own = planes[(planes["method"] == "shift_and_sum") & (planes["reference"] == "shift_and_sum")]
    assert {*own["psnr_db"]} == {100.0}
    assert summary["mpsnr_db"][0] == pytest.approx(planes["psnr_db"][:16].mean())
    answer = answers.of_evaluation(summary, planes)
    assert answer.ours == "run"
    assert answer.sentence in (trained / "eval" / "eval.log").read_text()
    assert len([*(trained / "eval" / "crops").glob("*.png")]) == 5
    for picture in ("scatter.png", "quality_by_plane.png", "comparison/simulated_s0_e0_000.png"):
        assert (trained / "eval" / picture).stat().st_size > 1000
    words = (f"runs=[{trained}/run,{trained}/eval]", "title='A <title>'")
    assert lfref("report", f"output={trained}/report", *words)[0] == 0
    page = (trained / "report" / "index.html").read_text()
    for words in ("A &lt;title&gt;", "Machine and versions", "MPSNR against MSSIM", "data:image/png;base64"):
        assert words in page


BODY = slice(140, 215), slice(250, 380)
WALL = slice(60, 120), slice(150, 400)


def detail(planes):
    return (planes[..., 1:] - planes[..., :-1]).square().mean(dim=(1, 2, 3))


def test_refocusing_the_real_capture(lfref, lytro, tmp_path):
    words = ("refocus", f"input={lytro}", "reader.encoding=linear", "alphas=[0.5,0.75,1]", f"output={tmp_path}/out")
    assert lfref(*words)[0] == 0
    stack, _ = read_stack(tmp_path / "out" / "stack.exr")
    assert stack.shape == (3, 3, 383, 552)
    # The body of the animal is in focus at alpha 0.5, the wall behind it at alpha 1.
    body, wall = (detail(stack[:, :, rows, columns]) for rows, columns in (BODY, WALL))
    assert body[0] > 4 * body[2]
    assert wall[2] > 1.5 * wall[0]
