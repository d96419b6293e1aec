"""Encodings of light: the tone curve between linear light and the samples of files.

Only linear values may be averaged: samples are decoded when a file is read, and pictures are encoded when they are
written. Every curve also has values below 0. Source of `srgb`: IEC 61966-2-1, 1999.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError

REMEDY = "say linear, srgb, gamma:2.2 or another exponent, none, or file for what the file says"


def srgb(light: Tensor, gamma: float) -> Tensor:
    """Encode linear light for a standard screen; `gamma` is not used."""
    return torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light.clamp(min=1e-3) ** (1 / 2.4) - 0.055)


def from_srgb(samples: Tensor, gamma: float) -> Tensor:
    """Undo `srgb`; `gamma` is not used."""
    return torch.where(samples <= 0.04045, samples / 12.92, ((samples.clamp(min=0.04) + 0.055) / 1.055) ** 2.4)


def power(values: Tensor, exponent: float) -> Tensor:
    """Raise absolute values to a power above 0; signs stay."""
    # At 0 the gradient of a power below 1 is infinite: 0 is cut out.
    size = values.abs()
    return torch.where(size > 0, values.sign() * size.clamp(min=1e-30) ** exponent, 0.0)


class Curve(NamedTuple):
    """A tone curve and its inverse, functions of values and the exponent `gamma`."""

    encode: Callable[[Tensor, float], Tensor]
    decode: Callable[[Tensor, float], Tensor]


CURVES: dict[str, Curve] = {
    "linear": Curve(lambda light, gamma: light, lambda samples, gamma: samples),
    "srgb": Curve(srgb, from_srgb),
    "gamma": Curve(lambda light, gamma: power(light, 1 / gamma), power),
}


@dataclass(frozen=True)
class Encoding:
    """A tone curve by name; `parsed` reads its text."""

    curve: str = "linear"
    """A key of `CURVES`."""
    gamma: float | None = None
    """Exponent of the curve `gamma`."""
    is_known: bool = True
    """False: samples are used as light without decoding, and are not encoded again."""

    def __str__(self) -> str:
        if not self.is_known:
            return "none"
        return self.curve if self.gamma is None else f"{self.curve}:{self.gamma:g}"

    def encode(self, light: Tensor) -> Tensor:
        """Samples of linear light, any shape."""
        return CURVES[self.curve].encode(light, self.gamma or 1.0)

    def decode(self, samples: Tensor) -> Tensor:
        """Linear light of samples, any shape."""
        return CURVES[self.curve].decode(samples, self.gamma or 1.0)


LINEAR, SRGB, NONE = Encoding(), Encoding("srgb"), Encoding(is_known=False)
_NAMED = {str(encoding): encoding for encoding in (LINEAR, SRGB, NONE)}


def parsed(text: str) -> Encoding:
    """The encoding of a text: `linear`, `srgb`, `gamma:EXPONENT` in [0.1, 10], or `none`, which decodes nothing."""
    if (known := _NAMED.get(text)) is not None:
        return known
    curve, _, exponent = text.partition(":")
    try:
        gamma = float(exponent)
    except ValueError:
        gamma = math.nan
    if curve != "gamma" or not 0.1 <= gamma <= 10:
        raise InputError("encoding must name a tone curve", got=repr(text), remedy=REMEDY)
    return Encoding("gamma", gamma)
