"""What engines are measured on is what a network reads of light fields, and what a lens would have recorded of them."""

import pytest
import torch

from lfref import geometry
from lfref.bench import engine_subjects
from lfref.bench.engine_subjects import Fields
from lfref.data.plane_sets import Recipe
from lfref.data.sources import SimulatedSource
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import operators
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

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
    subject = engine_subjects.of_network("net", network(), fields, PLANES, True, CPU)
    assert [shot.scene for shot in subject.shots] == [field.name for field in fields.whole]
    for shot, field in zip(subject.shots, fields.whole, strict=True):
        assert torch.equal(shot.inputs[0], field.views)
        assert torch.equal(shot.truth, field.photograph(PLANES.values))
        assert subject.network(*shot.inputs).shape == shot.truth.shape
    assert [tuple(views.shape) for (views,) in subject.patches] == [(3, 3, 3, 24, 24)]
    assert not subject.network.training


def test_a_network_without_training_makes_pictures_as_bright_as_the_scenes_and_a_trained_one_is_left_alone(fields):
    raw, kept = network(), network()
    before = kept.head.weight.clone()
    engine_subjects.of_network("net", kept, fields, PLANES, True, CPU)
    assert torch.equal(kept.head.weight, before)
    subject = engine_subjects.of_network("net", raw, fields, PLANES, False, CPU)
    with torch.no_grad():
        made = subject.network(*subject.patches[0])
    assert made.mean() == pytest.approx(float(fields.patches[0].photograph(PLANES.values).mean()), abs=0.02)
    assert made.std() > 0.03


def test_a_refiner_reads_guides_and_the_pictures_of_its_base(fields):
    base = operators.OperatorRefocuser("sum", shift_and_sum)
    recipe = Recipe(RandomScenes(), base, guides=("picture", "central"))
    refiner = engine_subjects.untrained_refiner(recipe, fields.patches[0], PLANES)
    subject = engine_subjects.of_refiner("refiner", refiner, fields, PLANES, recipe, False)
    field, (guides, pictures) = fields.whole[0], subject.shots[0].inputs
    assert torch.equal(pictures, base(field, PLANES.slopes))
    assert torch.equal(guides[:, :3], pictures - 0.5)
    assert guides.shape == (2, 6, 32, 40)
    assert (guides.stride(), pictures.stride()) == ((6 * 1280, 1280, 40, 1), (3 * 1280, 1280, 40, 1))
    with torch.no_grad():
        assert (subject.network(guides, pictures) - pictures).std() > 1e-3
