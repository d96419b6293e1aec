"""`lfref bench` evaluates by the truth where it is known, and names the reference where it is not."""

import csv
import json
import re

import pytest
from matplotlib.image import imread

from lfref.cli import config as configs
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
