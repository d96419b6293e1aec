"""A scene is analyzed once for many stacks, and no method waits for a GPU after its checks."""

import pytest
import torch

import lfref
from lfref.errors import InputError
from lfref.refocus import scene as scenes
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.pretended_gpu import Gpu, on_cpu, on_gpu

PLANES = lfref.planes_at_alphas([0.125, 0.25, 0.5, 0.8, 1, 1.2, 1.6, 2]).slopes
NEED_SCENES = {
    "shift_and_sum_antialiased": lfref.shift_and_sum_antialiased,
    "separable_wiener": lfref.separable_wiener,
    "blockwise_wiener": lfref.blockwise_wiener,
    "refocus_by_layers": lfref.refocus_by_layers,
}
OTHERS = {"shift_and_sum": lfref.shift_and_sum, "exact_fourier": lfref.exact_fourier}
MOST_OPERATIONS = {
    "shift_and_sum": 200,
    "shift_and_sum_antialiased": 1400,
    "exact_fourier": 120,
    "separable_wiener": 1750,
    "blockwise_wiener": 4300,
    "refocus_by_layers": 1500,
}
"""Of a first stack, after the checks; at 7 microseconds each, a GPU needs so long whatever it computes."""


@pytest.fixture(scope="module")
def views():
    return simulate(sim30.SCENES["twigs"], outputs=("views",)).views[..., 8:-8, 8:-8].contiguous()


@pytest.mark.parametrize("name", NEED_SCENES)
def test_a_scene_gives_the_pictures_of_the_light_field(name, views):
    method, known = NEED_SCENES[name], lfref.analyze_scene(views)
    for slopes in (PLANES[:2], PLANES[2:]):
        assert torch.equal(method(views, slopes, scene=known), method(views, slopes))


def test_a_scene_is_estimated_once(views, monkeypatch):
    known = lfref.analyze_scene(views[..., :48, :64])
    first = lfref.blockwise_wiener(views[..., :48, :64], [0.3], scene=known)
    for estimate in ("estimate_energies", "coarse_disparity"):
        monkeypatch.setattr(scenes, estimate, pytest.fail)
    monkeypatch.setattr(scenes.noise_line, "measured", pytest.fail)
    assert torch.equal(lfref.blockwise_wiener(views[..., :48, :64], [0.3], scene=known), first)


def test_a_scene_of_other_views_is_refused(views):
    known = lfref.analyze_scene(views)
    for others in (views[..., :40], torch.stack([views, views])):
        with pytest.raises(InputError, match="scene is that of a light field of shape"):
            lfref.separable_wiener(others, [0.0], scene=known)
    with pytest.raises(InputError, match="one light field"):
        lfref.analyze_scene(views[None])
    with pytest.raises(InputError, match="finite"):
        lfref.analyze_scene(torch.full_like(views, torch.nan))


@pytest.mark.parametrize("name", MOST_OPERATIONS)
def test_no_method_waits_for_a_gpu_after_its_checks(name, views):
    expected = (NEED_SCENES | OTHERS)[name](views, PLANES)
    with torch.no_grad(), Gpu(may_wait=True) as gpu:
        there, options = on_gpu(views), {}
        if name in NEED_SCENES:
            options = {"scene": lfref.analyze_scene(there)}
        assert len(gpu.waits) <= 1  # whether views are finite, and whether they move far
        gpu.may_wait, n_before = False, gpu.n_operations
        stack = (NEED_SCENES | OTHERS)[name](there, PLANES, **options)
        assert gpu.n_operations - n_before <= MOST_OPERATIONS[name]
    assert stack.device.type != "cpu"
    # Whether light is in focus depends on differences of squares, which are rounded.
    tolerance = 1e-4 if name in ("separable_wiener", "blockwise_wiener", "refocus_by_layers") else 1e-5
    torch.testing.assert_close(on_cpu(stack), expected, atol=tolerance, rtol=0)


def test_filters_of_all_views_do_not_wait_either():
    wide = simulate(sim30.WIDE["wide_near_5"], outputs=("views",), slopes=[0.0]).views[..., :96, :128].contiguous()
    slopes = [0.0, 2.5, 7.0]
    expected = lfref.blockwise_wiener(wide, slopes)
    with torch.no_grad(), Gpu(may_wait=True) as gpu:
        known = lfref.analyze_scene(on_gpu(wide))
        assert known.known is not None
        gpu.may_wait = False
        stack = lfref.blockwise_wiener(known.views, slopes, scene=known)
    # Votes are summed in another order, and near ties move disparities by some 1e-4.
    torch.testing.assert_close(on_cpu(stack), expected, atol=2e-4, rtol=0)
