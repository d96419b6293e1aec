"""Results that caches depend on are those of the stored `VERSION`: whoever changes them raises the number.

The expected values lie in versions.npz, compared with a tolerance, since other machines round differently. After a
change on purpose: raise the version, and write the file anew by `python -m tests.data.test_versions`.
"""

import dataclasses
import functools
import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from lfref.captures import correct as corrections
from lfref.captures.correct import correct
from lfref.io import images
from lfref.io import read as reader
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.effects import optics
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.simulate import simulate

EXPECTED = Path(__file__).with_name("versions.npz")
SIZE = (6, 8)


def decoded(folder):
    """Views of one small light field per format."""
    samples = torch.linspace(0, 1, 9 * 3 * 48).reshape(3, 3, 3, *SIZE)
    weight = torch.linspace(1, 0, 9 * 48).reshape(3, 3, 1, *SIZE)
    field = LightField(samples, weight=weight)
    paths = {kind: write(folder / f"{kind}{suffix}", field, bits=bits) for kind, suffix, bits in
             (("folder8", "", 8), ("folder16", "", 16), ("exr", ".exr", 32))}  # fmt: skip
    lenslets = samples.permute(3, 0, 4, 1, 2).reshape(18, 24, 3)
    images.write_image(folder / "eslf.png", lenslets.numpy(), bits=8)
    np.save(folder / "array.npy", samples.numpy())
    read = {kind: reader.read(path) for kind, path in paths.items()}
    read["eslf"] = reader.read(folder / "eslf.png", lenslet=3, angular_size=3)
    read["array"] = reader.read(folder / "array.npy", axes="vuchw")
    return torch.stack([field.views for field in read.values()])


def corrected(folder):
    """A capture with shifted, shaded, hot and black views after its corrections, in blocks of 16 pixels."""
    views = simulate(dataclasses.replace(sim30.SCENES["shards"], sensor=Sensor()), outputs=("views",)).views
    random = torch.Generator().manual_seed(1)
    views = optics.shift(views, 0.3 * torch.randn(7, 7, 2, dtype=torch.float64, generator=random))
    views[1, 5] *= 1.1
    views[0, 0] *= 0.01
    views[2, 3, 1, 40:60:7, 50:90:9] = 1.0
    field, found = correct(LightField(views))
    blocks = F.avg_pool2d((field.views * field.weight).flatten(0, 1), 16)[::5]
    return torch.cat([blocks.flatten(), found["alignment"].shifts.flatten().float()])


def description(value):
    """A scene's parameters that differ from their defaults: new fields of a sensor change nothing."""
    if dataclasses.is_dataclass(value):
        fields = [(field.name, getattr(value, field.name), field.default) for field in dataclasses.fields(value)]
        return [type(value).__name__, *((name, description(now)) for name, now, default in fields if now != default)]
    return [description(item) for item in value] if isinstance(value, tuple) else repr(value)


def described(folder):
    """A digest of all parameters of the thirty scenes, as bytes."""
    scenes = [[name, *map(description, scenes.values())] for name, scenes in sim30.VERSIONS.items()]
    return torch.tensor(list(hashlib.sha256(repr(scenes).encode()).digest()))


CHECKS = {
    "decoded": (decoded, 1e-5, "VERSION in lfref/io/read.py", reader.VERSION),
    "corrected": (corrected, 2e-3, "VERSION in lfref/captures/correct.py", corrections.VERSION),
    "described": (described, 0, "VERSION and VERSION_2 in lfref/simulator/sim30.py", sim30.VERSION),
}


@functools.cache
def expected():
    with np.load(EXPECTED) as content:
        return dict(content)


@pytest.mark.parametrize("name", CHECKS)
def test_results_that_caches_keep_change_with_their_version_only(name, tmp_path):
    compute, tolerance, where, version = CHECKS[name]
    remedy = f"then write {EXPECTED.name} anew: python -m tests.data.test_versions"
    got, known = compute(tmp_path).numpy(), expected()[name]
    is_equal = got.shape == known.shape and np.allclose(got, known, atol=tolerance, rtol=0)
    assert is_equal, f"results changed: bump {where}, {remedy}"
    assert str(version) == str(expected()[f"{name}_version"]), f"{where} was raised: {remedy}"


if __name__ == "__main__":
    import tempfile

    contents = {}
    for name, (compute, _, _, version) in CHECKS.items():
        with tempfile.TemporaryDirectory() as folder:
            values = compute(Path(folder)).numpy()
        contents |= {name: values.astype("f4" if values.dtype.kind == "f" else values.dtype)}
        contents |= {f"{name}_version": np.array(str(version))}
    np.savez_compressed(EXPECTED, **contents)
