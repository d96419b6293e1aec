"""A disc before a wall, whose disparities are known, refocused by two methods."""

import base64
import dataclasses
import functools
import io
import re

import numpy as np
import pytest
import torch

from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.report.refocused import Refocused
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Noise
from lfref.viewer.coding import ZERO, Prediction

PLANES = FocalPlanes([1.0, -1.0, -0.5, 0.0, 0.5])  # in no order
FAR, NEAR = -0.62, 0.83


@functools.cache
def scene(grid=(5, 5), size=(96, 128)):
    """Views, and the true disparity of each pixel."""
    wall = Surface(Plane(FAR), Noise((0.5, 0.4, 0.3), (0.3, 0.3, 0.3)))
    disc = Surface(Plane(NEAR), Noise((0.3, 0.5, 0.4), (0.3, 0.3, 0.3)), Disc(28.0))
    simulated = simulate(Scene(Camera(grid, size), (wall, disc)), outputs=("views", "disparity"))
    return LightField(simulated.views.clamp(0, 1), "disc <before> a wall"), simulated.disparity


def with_black_corners():
    """The views with round black corners, of weight 0, that lie elsewhere in each view."""
    field, _ = scene()
    y, x = torch.meshgrid(torch.arange(96) - 47.5, torch.arange(128) - 63.5, indexing="ij")
    steps = torch.arange(5) - 2
    radius = torch.hypot(y + 3 * steps[:, None, None, None], x + 3 * steps[:, None, None])
    weight = (radius < 72).float()[:, :, None]
    return dataclasses.replace(field, views=field.views * weight, weight=weight)


def methods(**options):
    field, _ = scene(**options)
    stack = shift_and_sum(field.views, PLANES.slopes)
    stacks = {"linear": stack, "dim": 0.6 * stack}
    return {name: Refocused(field, stack, PLANES) for name, stack in stacks.items()}


def pixels(uri, kind="(jpeg|webp)"):
    """Samples of a picture of the page, in [0, 1]."""
    Image = pytest.importorskip("PIL.Image")
    head, _, text = uri.partition(",")
    assert re.fullmatch(f"data:image/{kind};base64", head)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))), np.float64) / 255


def views(content):
    """The views as a page with this content shows them, [H, W, 3] each."""
    depth, views = content["depth"], content["views"]
    pictures = [pixels(picture) for picture in views["pictures"]]
    if (reference := views["reference"]) is None:
        return pictures
    steps = np.frombuffer(base64.b64decode(depth["disparity"]), "<u2").reshape(content["size"])
    disparity = depth["low"] + steps / 65535 * (depth["high"] - depth["low"])
    prediction = Prediction(pictures[reference], views["cameras"][reference], disparity)
    return [
        picture if k == reference else (prediction.view(camera) + picture - ZERO).clip(0, 1)
        for k, (picture, camera) in enumerate(zip(pictures, views["cameras"], strict=True))
    ]
