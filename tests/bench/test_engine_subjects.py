"""What engines are measured on is what a network reads of light fields, and what a lens would have recorded of them."""

import pytest
import torch

from lfref import geometry
from lfref.bench import engine_timing
from lfref.bench.engine_timing import Fields
from lfref.data.field_sources import SimulatedSource
from lfref.nets.refiner import Refiner
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import refined
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

BASE = OperatorRefocuser("sum", shift_and_sum)
CPU = torch.device("cpu")
PLANES = geometry.even_planes(2)


@pytest.fixture(scope="module")
def fields():
    def drawn(size, seed, count):
        source = SimulatedSource(count, seed, RandomScenes(Camera(grid=(3, 3), size=size)))
        return [source.field(index) for index in range(count)]

    return Fields(drawn((32, 40), 1, 2), drawn((24, 24), 2, 1))


def network():
    return RefNet(n_planes=2, grid=(3, 3), widths=(8,), stem_width=8)


def test_a_network_reads_views_and_is_judged_by_photographs(fields):
    subject = engine_timing.of_network("net", network(), fields, PLANES, True, CPU)
    assert [shot.scene for shot in subject.shots] == [field.name for field in fields.whole]
    for shot, field in zip(subject.shots, fields.whole, strict=True):
        assert torch.equal(shot.parts[0][0], field.views)
        assert torch.equal(shot.truth, field.photograph(PLANES.values))
        assert shot.stack(subject.network).shape == shot.truth.shape
    assert [tuple(views.shape) for (views,) in subject.patches] == [(3, 3, 3, 24, 24)]
    assert not subject.network.training


def test_a_network_without_training_makes_pictures_as_bright_as_the_scenes_and_a_trained_one_is_left_alone(fields):
    raw, kept = network(), network()
    before = kept.head.weight.clone()
    engine_timing.of_network("net", kept, fields, PLANES, True, CPU)
    assert torch.equal(kept.head.weight, before)
    subject = engine_timing.of_network("net", raw, fields, PLANES, False, CPU)
    with torch.no_grad():
        made = subject.network(*subject.patches[0])
    assert made.mean() == pytest.approx(float(fields.patches[0].photograph(PLANES.values).mean()), abs=0.02)
    assert made.std() > 0.03


def test_a_refiner_reads_features_and_pictures_in_the_parts_that_its_refocuser_makes(fields, monkeypatch):
    network = Refiner(6, 1, width=8, n_blocks=1)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    refiner = RefinedRefocuser(network, BASE, ("central", "picture"), "refined")
    monkeypatch.setattr(refined, "AT_ONCE", 3 * 6 * 32 * 40)
    # Digits are compared here, which half of them would hide.
    monkeypatch.setattr(refined, "_is_half_faster", lambda device: False)
    planes = geometry.even_planes(4)
    subject = engine_timing.of_refiner(refiner, fields, planes, CPU)
    for shot, field in zip(subject.shots, fields.whole, strict=True):
        # Three planes would fit, and the fourth would be a part of another shape.
        assert [tuple(features.shape) for features, *_ in shot.parts] == [(2, 6, 32, 40)] * 2
        with torch.no_grad():
            stack = shot.stack(subject.network)
        torch.testing.assert_close(stack, refiner(field, planes.slopes), atol=1e-5, rtol=0)
        assert (stack - BASE(field, planes.slopes)).std() > 1e-3
        assert torch.equal(shot.truth, field.photograph(planes.values))
    assert [tuple(features.shape) for features, *_ in subject.patches] == [(2, 6, 24, 24)] * 2
    assert (subject.name, subject.is_trained) == ("refined", True)
