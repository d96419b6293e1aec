"""Light fields whose views or colours are displaced: scenes of the simulator, moved by its own effects."""

import dataclasses
import functools

import torch

from lfref import geometry
from lfref.simulator.effects import optics
from lfref.simulator.effects.optics import Chromatic

from .scenes import clean


@functools.cache
def shifts(size=0.25, seed=1):
    """Down and right, of the kind that can be known: no mean, nothing linear in the place."""
    drawn = size * torch.randn(49, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    places = torch.cartesian_prod(*[geometry.angular_offsets(7)] * 2)
    linear = torch.cat([torch.ones(49, 1, dtype=torch.float64), places], 1)
    return (drawn - linear @ torch.linalg.lstsq(linear, drawn).solution).unflatten(0, (7, 7))


def misaligned(name, moved):
    field = clean(name)
    return dataclasses.replace(field, views=optics.shift(field.views, moved.flip(-1)))


def dispersed(name, magnification, disparity):
    field = clean(name)
    return dataclasses.replace(field, views=Chromatic(magnification, disparity).apply(field.views, torch.Generator()))


def stretched(name, ratio):
    """A picture that is taller has larger disparities along rows: as of rows of views farther apart."""
    field = clean(name)
    rows, columns = (geometry.angular_offsets(n) for n in field.size)
    return dataclasses.replace(field, views=optics.resample(field.views, rows / ratio, columns))


def noisy(field, size=0.02):
    noise = torch.randn(field.views.shape, generator=torch.Generator().manual_seed(3))
    return dataclasses.replace(field, views=field.views + size * noise)


def rms(values):
    return float(values.square().mean().sqrt())
