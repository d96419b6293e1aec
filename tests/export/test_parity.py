"""Cases cover sizes, several at once and frames that show nothing; what is off is found, and by how much."""

import dataclasses
import math

import pytest
import torch

from lfref.export import graphs, parity
from lfref.export.parity import Tolerance
from tests.export import cases


def subject():
    return graphs.exportable(cases.network(), cases.PLANES, cases.GRID)


def test_cases_are_every_size_four_at_once_and_flat_frames():
    tried = list(parity.cases(subject(), cases.FIELDS))
    assert [case.name for case in tried] == ["drawn_0", "drawn_1", "drawn_2", "turned", "black", "grey", "white"]
    assert [case.n_fields for case in tried] == [1, 1, 1, 4, 1, 1, 1]
    assert {case.size for case in tried} == {(31, 45), (24, 32), (40, 33)}
    black, white = (next(case.inputs[0] for case in tried if case.name == name) for name in ("black", "white"))
    assert float(black.abs().max()) == 0
    assert float(white.min()) == 1
    turned = tried[3].inputs[0]
    assert torch.equal(turned[1], turned[0].flip(-1))


def test_how_far_an_engine_is_off_is_told_case_by_case():
    exact = subject()
    runs = {"same": exact.reference, "off": lambda views: exact.reference(views) + 0.01}
    rows = list(parity.rows(exact, runs, parity.cases(exact, cases.FIELDS[:1])))
    assert [row["engine"] for row in rows[:2]] == ["same", "off"]
    assert all(row["max_error"] == 0 and row["psnr_db"] == 100 for row in rows[::2])
    assert all(abs(row["max_error"] - 0.01) < 1e-6 and abs(row["psnr_db"] - 40) < 0.01 for row in rows[1::2])
    assert parity.worst(rows[::2], Tolerance(error=1e-6)) is None
    assert parity.worst(rows, Tolerance(psnr_db=39)) is None
    assert parity.worst(rows, Tolerance(psnr_db=41))["engine"] == "off"
    flat = [row for row in rows if row["case"] in parity.FLAT]
    assert parity.worst(flat, Tolerance(psnr_db=41)) is None, "in low precision, flat frames are held to less"
    assert parity.worst(flat, Tolerance(error=1e-4)) is not None


def test_noise_that_a_network_makes_itself_is_no_fault_of_a_file():
    subject = graphs.exportable(cases.untrained(), cases.PLANES, cases.GRID)

    def doubled(views):
        return subject.reference(views) + 2 * (subject.exact(views).float() - subject.reference(views))

    runs = {
        "doubled": doubled,
        "far": lambda views: subject.reference(views) + 1e3,
        "nan": lambda views: views.mean() / 0,
    }
    rows = list(parity.rows(subject, runs, parity.cases(subject, cases.FIELDS[:1])))
    assert parity.own_noise(rows).keys() == {"black"}
    assert all(row["own_error"] == 0 for row in rows if row["case"] not in parity.FLAT)
    black = {row["engine"]: row for row in rows if row["case"] == "black"}
    assert black["doubled"]["max_error"] == pytest.approx(2 * black["doubled"]["own_error"], rel=1e-3)
    for tolerance, engines in (
        (parity.TOLERANCES["fp32"], ["far", "nan"]),
        (Tolerance(error=1e-4), ["doubled", "far", "nan"]),  # by PyTorch, which rounds as PyTorch does
        (Tolerance(psnr_db=40), ["nan"]),
    ):
        assert [name for name, row in black.items() if parity.worst([row], tolerance)] == engines
    scene = [row for row in rows if row["engine"] == "far" and row["case"] == "drawn_0"]
    assert parity.worst(scene, Tolerance(error=1e-4)), "of scenes nothing is excused"


@pytest.mark.parametrize(
    ("own_error", "is_held"), [(0.0, True), (2e-4, True), (0.05, True), (0.06, False), (2.5, False)]
)
def test_low_precision_is_held_to_flat_frames_unless_float32_itself_is_as_far_off(own_error, is_held):
    row = {"case": "grey", "max_error": 0.2, "psnr_db": 20.0, "own_error": own_error, "before_db": 0.0}
    assert (parity.worst([row], parity.TOLERANCES["bf16"]) is not None) == is_held
    assert parity.worst([row | {"case": "drawn"}], parity.TOLERANCES["bf16"]) is not None


def test_a_file_that_corrects_nothing_is_told_however_small_corrections_are():
    subject = graphs.exportable(cases.refiner(), cases.PLANES, cases.GRID)

    def towards(share):
        return lambda *inputs: inputs[1] + share * (subject.reference(*inputs) - inputs[1])

    # Noise gives this refiner something to correct.
    views = cases.FIELDS[0].views
    noisy = views + 0.02 * torch.randn(views.shape, generator=torch.Generator().manual_seed(0))
    tried = list(parity.cases(subject, [dataclasses.replace(cases.FIELDS[0], views=noisy)]))
    runs = {"nothing": towards(0.0), "too little": towards(0.4), "about": towards(0.9), "same": towards(1.0)}
    rows = [row for row in parity.rows(subject, runs, tried) if row["case"] == "drawn_0"]
    assert all(0 < row["before_db"] < parity.CORRECTED_DB for row in rows)
    assert rows[0]["psnr_db"] == rows[0]["before_db"]
    violations = [row["engine"] for row in rows if parity.worst([row], Tolerance(psnr_db=0.1))]
    assert violations == ["nothing", "too little"]


def test_stacks_that_are_not_finite_or_of_another_shape_are_off_by_more_than_anything():
    exact = subject()
    runs = {"nan": lambda views: exact.reference(views) * math.nan, "less": lambda views: exact.reference(views)[:, :1]}
    rows = list(parity.rows(exact, runs, parity.cases(exact, cases.FIELDS[:1])))
    assert all(row["max_error"] == math.inf for row in rows)
    assert parity.worst(rows, Tolerance(psnr_db=1)) is not None


@pytest.mark.parametrize(
    ("precision", "row", "holds"),
    [
        ("fp32", {"max_error": 0.9e-4}, True),
        ("fp32", {"max_error": 1.1e-4}, False),
        ("fp16", {"psnr_db": 50.1}, True),
        ("fp16", {"psnr_db": 49.9}, False),
        ("bf16", {"psnr_db": 50.1}, True),
        ("bf16", {"psnr_db": 49.9}, False),
        ("int8", {"psnr_db": 40.1}, True),
        ("int8", {"psnr_db": 39.9}, False),
        # Float32 that differs from float64 by 1e-4 or less is no noise of the network's own.
        ("fp32", {"case": "black", "own_error": 1.1e-4, "max_error": 4.3e-4}, True),
        ("fp32", {"case": "black", "own_error": 1.1e-4, "max_error": 4.5e-4}, False),
        ("fp32", {"case": "black", "own_error": 0.9e-4, "max_error": 1.5e-4}, False),
        ("int8", {"case": "grey", "psnr_db": 25.1}, True),
        ("int8", {"case": "grey", "psnr_db": 24.9}, False),
        # Pictures of a refiner's file come 6 dB nearer than uncorrected ones, unless these are within 90 dB.
        ("int8", {"before_db": 50.0, "psnr_db": 56.1}, True),
        ("int8", {"before_db": 50.0, "psnr_db": 55.9}, False),
        ("int8", {"before_db": 89.0, "psnr_db": 89.0}, False),
        ("int8", {"before_db": 91.0, "psnr_db": 91.0}, True),
    ],
)
def test_limits_of_every_precision(precision, row, holds):
    whole = {"case": "drawn", "max_error": 0.0, "psnr_db": 100.0, "own_error": 0.0, "before_db": 0.0} | row
    assert (parity.worst([whole], parity.TOLERANCES[precision]) is None) == holds
