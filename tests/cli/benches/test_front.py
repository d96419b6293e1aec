"""`lfref bench` evaluates by the truth where it is known, and names the reference where it is not."""

import csv
import json
import re
import shutil

import numpy as np
import pytest
import torch
from matplotlib.image import imread

import lfref as lfref_package
from lfref.cli import bench
from lfref.cli import config as configs
from lfref.functional.psnr import psnr
from lfref.io.read import read_stack
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.report import answers, crops
from lfref.report.tables import read_table
from lfref.simulator import sim30

QUICK = ("repeats=1", "warmup=0", "device=cpu", "planes.alphas=[0.5,1]")
CLASSES = ("ideal", "sensor", "corrected")
KEPT = ("shift_and_sum", "exact_fourier")
NAMES = re.findall(r"methods\.(\w+):", (configs.directory() / "group" / "front.yaml").read_text())
FEW = (*(f"~methods.{name}" for name in NAMES if name not in KEPT), "aliased=false", "wide=false")


def tables(folder):
    names = ("bench", "scenes", "planes", "evaluation")
    return {name: list(csv.DictReader((folder / f"{name}.csv").read_text().splitlines())) for name in names}


@pytest.fixture
def front(lfref, tmp_path):
    """Function (*words) -> tables and folder of a run of group front."""

    def run(*words):
        status, errors = lfref("bench", *QUICK, *FEW, *words, f"output={tmp_path}/run")
        assert status == 0, errors
        return tables(tmp_path / "run"), tmp_path / "run"

    return run


def test_methods_that_are_null_are_left_out(composed):
    config = composed("bench", *FEW, "methods.exact_fourier=null")
    assert [method.name for method in bench._methods(config, torch.device("cpu"))] == ["shift_and_sum"]


def test_light_fields_of_one_name_are_told_apart(front, lfref, tmp_path):
    for number, session in enumerate(("morning", "evening")):
        words = (f"seed={number}", "scene.camera.size=[48,56]", "scene.camera.grid=[3,3]", "outputs=[views]")
        assert lfref("simulate", *words, f"output={tmp_path}/made")[0] == 0
        (tmp_path / session).mkdir()
        (tmp_path / "made" / f"simulated_s{number}_e0_000").rename(tmp_path / session / "first")
        shutil.rmtree(tmp_path / "made")
    found, _ = front(f"input=[{tmp_path}/morning/first,{tmp_path}/evening/first]", "margin=8")
    assert {row["scene"] for row in found["scenes"]} == {"morning_first", "evening_first"}


def test_scenes_are_evaluated_by_truth_without_their_sensor_with_it_and_corrected(front):
    found, folder = front("test_scenes=[stripes,graded]", "scene.camera.size=[32,40]")
    assert [(row["method"], row["class"], row["reference"]) for row in found["bench"]] == [
        ("numpy_fft_4d", "", ""),
        *((method, kind, "truth") for method in ("shift_and_sum", "exact_fourier") for kind in CLASSES),
    ]  # fmt: skip
    ideal = [row for row in found["bench"] if row["class"] == "ideal"]
    assert all(float(row["psnr_db"]) > 45 and float(row["brightness_error"]) < 0.002 for row in ideal)
    assert float(ideal[1]["exact_psnr_db"]) == 70  # equal; means are capped
    assert [(row["class"], row["method"], row["scene"]) for row in found["scenes"]] == [
        (kind, method, scene)
        for kind, scene in (("ideal", "stripes"), ("ideal", "graded"), ("sensor", "graded"), ("corrected", "graded"))
        for method in ("shift_and_sum", "exact_fourier")
    ]
    assert len(found["planes"]) == 3 * 2 * 2
    assert len(found["evaluation"]) == 4 * 2 * 2
    assert all(imread(folder / f"{name}.png").std() > 0.05 for name in ("accuracy_time", "by_plane"))
    assert json.loads((folder / "machine.json").read_text())["sim30"] == sim30.VERSION
    assert {row["is_network"] for row in found["bench"]} == {"False"}


def test_the_mean_of_views_explains_nothing_and_is_the_plainest_point(lfref, tmp_path):
    words = (*QUICK, *(word for word in FEW if word != "~methods.mean_of_views"), "planes.alphas=[0.25,0.8,1]")
    words += ("test_scenes=[stripes,graded]", "scene.camera.size=[32,40]", "correct=none")
    assert lfref("bench", *words, f"output={tmp_path}/run")[0] == 0
    rows = read_table(tmp_path / "run" / "bench.csv").set_index(["method", "class"])
    planes = read_table(tmp_path / "run" / "evaluation.csv").query("`class` == 'ideal' and slope != 0")
    errors = (10 ** (-planes["psnr_db"] / 10)).groupby(planes["method"]).sum()
    for method in (*KEPT, "mean_of_views"):
        row, own = rows.loc[method, "ideal"], planes[planes["method"] == method]
        assert row["explained"] == pytest.approx(1 - errors[method] / errors["mean_of_views"])
        assert row["nonzero_psnr_db"] == pytest.approx(own["psnr_db"].clip(upper=70).mean())
    assert rows.loc["shift_and_sum", "ideal"]["explained_wide"] > 0.5


def test_the_log_has_the_answer_and_crops_show_where_ours_is_worst(front):
    _, folder = front("test_scenes=[stripes,graded]", "scene.camera.size=[32,40]", "margin=4", "aliased=true")
    answer = answers.of_bench(*(read_table(folder / f"{name}.csv") for name in ("bench", "scenes")))
    assert answer.kind == "ideal"
    assert answer.sentence in (folder / "bench.log").read_text()
    shown = crops.read(folder, answer)
    assert len(shown) == 5
    _, other, ours, truth, _ = (imread(file).astype(float) for file in shown.values())
    assert all(picture.shape == truth.shape and truth.std() > 0.05 for picture in (ours, other))
    # The plane is our worst one, so its error is that of the table; the crop is where it is greatest.
    worst = min(
        float(row["psnr_db"])
        for row in tables(folder)["evaluation"]
        if (row["class"], row["scene"], row["method"]) == (answer.kind, answer.worst, answer.ours)
    )
    assert np.square(ours - truth).mean() ** 0.5 == pytest.approx(10 ** (-worst / 20), abs=0.004)


def test_the_aliased_version_stands_beside_the_other(front):
    found, folder = front("test_scenes=[stripes]", "scene.camera.size=[32,40]", "aliased=true")
    assert [(row["class"], row["scene"]) for row in found["scenes"][::2]] == [
        ("ideal", "stripes"),
        ("aliased", "stripes"),
    ]
    by_class = {(row["method"], row["class"]): row for row in found["bench"]}
    plain, aliased = (by_class["exact_fourier", kind] for kind in ("ideal", "aliased"))
    assert float(aliased["worst_plane_db"]) < float(plain["worst_plane_db"])
    assert aliased["worst_plane"].startswith("stripes at slope ")
    assert json.loads((folder / "machine.json").read_text())["aliased"] == sim30.VERSION_2


def test_the_reference_of_captures_is_exact_refocusing_and_the_log_says_so(lfref, front, tmp_path):
    assert lfref("simulate", f"output={tmp_path}/scenes", "n_fields=1", "scene.camera.size=[64,72]")[0] == 0
    found, folder = front(f"input={tmp_path}/scenes")
    assert {(row["class"], row["reference"]) for row in found["evaluation"]} == {("capture", "exact_fourier")}
    assert (float(found["bench"][2]["psnr_db"]), float(found["bench"][2]["median_psnr_db"])) == (70, 100)
    assert "no truth is known" in (folder / "bench.log").read_text()
    # One light field is no scatter, and exact_fourier is not drawn against itself.
    assert not (folder / "accuracy_time.png").exists()
    assert "judged by exact_fourier and not by the truth, shift_and_sum has" in (folder / "bench.log").read_text()


def test_light_fields_are_evaluated_by_a_truth_that_is_given(lfref, front, tmp_path):
    words = ("n_fields=2", "scene.camera.size=[64,72]", "planes.alphas=[0.5,1]")
    assert lfref("simulate", f"output={tmp_path}/scenes", *words)[0] == 0
    given, _ = front(f"input={tmp_path}/scenes", f"truth={tmp_path}/scenes", "margin=8")
    assert {(row["class"], row["reference"]) for row in given["evaluation"]} == {("given", "truth")}
    for row in given["evaluation"]:
        truth, planes = read_stack(tmp_path / "scenes" / f"{row['scene']}_truth.exr")
        views = lfref_package.read(tmp_path / "scenes" / row["scene"]).views
        plane = [round(slope, 3) for slope in planes.slopes.tolist()].index(round(float(row["slope"]), 3))
        stack = {"shift_and_sum": shift_and_sum, "exact_fourier": exact_fourier}[row["method"]](views, planes.slopes)
        pair = ((picture[plane][..., 8:-8, 8:-8].double()) for picture in (stack, truth))
        assert float(row["psnr_db"]) == pytest.approx(float(psnr(*pair)), abs=0.01)


def test_a_truth_that_does_not_fit_is_one_clear_line(lfref, tmp_path):
    words = ("n_fields=2", "scene.camera.size=[64,72]", "planes.alphas=[0.5,2]")
    assert lfref("simulate", f"output={tmp_path}/scenes", *words)[0] == 0
    for number, (more, expected) in enumerate(
        {
            (f"truth={tmp_path}/scenes",): "truth must be 2 planes of 64x72, alpha 0.5, alpha 1",
            (f"truth={next((tmp_path / 'scenes').glob('*_truth.exr'))}",): "must be a folder of NAME_truth.exr",
            (f"truth={tmp_path}/scenes", "thin=2"): "give one of them",
            (f"truth={tmp_path}",): "cannot be read",
            (f"truth={tmp_path}/scenes", "input=null"): "truth belongs to light fields of yours",
        }.items()
    ):
        status, errors = lfref(
            "bench", *QUICK, *FEW, f"input={tmp_path}/scenes", *more, f"output={tmp_path}/run{number}"
        )
        assert status == 1
        assert expected in errors, more
        assert "Traceback" not in errors


def test_the_reference_of_every_second_view_is_the_integral_over_all(lfref, front, tmp_path):
    words = ("n_fields=1", "scene.camera.size=[64,72]", "scene.camera.grid=[5,5]", "outputs=[views]")
    assert lfref("simulate", f"output={tmp_path}/scenes", *words)[0] == 0
    found, folder = front(f"input={tmp_path}/scenes", "thin=2")
    assert {(row["class"], row["reference"]) for row in found["evaluation"]} == {("hold_out", "dense_integral")}
    assert all(30 < float(row["psnr_db"]) < 100 for row in found["evaluation"])
    assert json.loads((folder / "machine.json").read_text())["views"] == "3x3x3x64x72"


def test_scenes_that_do_not_exist_are_one_clear_line(lfref, tmp_path):
    status, errors = lfref("bench", "test_scenes=[moon]", f"output={tmp_path}/run")
    assert status == 1
    assert "sim30 scene must be one of plane" in errors


def test_scenes_are_drawn_at_random_too(front):
    sizes = ("held_out.camera.size=[48,48]", "scene.camera.size=[32,40]")
    found, _ = front("test_scenes=[]", "varied=1", "margin=4", *sizes)
    assert {row["scene"] for row in found["scenes"]} == {"simulated_s2000003_e0_000"}
    assert {row["class"] for row in found["scenes"]} >= {"ideal", "corrected"}


def test_no_scenes_at_all_are_refused_in_a_line(lfref, tmp_path):
    status, errors = lfref("bench", *QUICK, *FEW, "test_scenes=[]", f"output={tmp_path}/run")
    assert status == 1
    assert "there must be scenes to evaluate; got none; set test_scenes, varied or wide" in errors
