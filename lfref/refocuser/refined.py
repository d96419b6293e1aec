"""Refiners as refocusers: the planes of a classical method, corrected by a small network.

Any planes, any number of them and any even grid of views, since the network sees each plane by itself, and views only
through guides.
"""

import functools
import inspect
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.errors import CheckpointError, InputError, chosen
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refiner import Correction, Refiner
from lfref.refocus import batches
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.through_cells import shift_and_sum_through_cells
from lfref.refocuser.features import GUIDES, Seen, check, guides
from lfref.refocuser.operators import Operator, OperatorRefocuser
from lfref.refocuser.refocuser import Aperture, Refocuser, uneven

KIND = "refiner"
"""What checkpoints call it."""
FORMAT = 1
BASES: dict[str, Operator] = {
    function.__name__: function
    for function in (occlusion_aware, refocus_by_layers, shift_and_sum, shift_and_sum_through_cells)
}
"""Methods whose pictures may be refined, as checkpoints name them."""
AT_ONCE = 2**23
"""Samples of guides that the network is given at once: features of all planes together leave the processor's caches."""

MATRICES = ("amx_bf16", "avx512_bf16")
"""Instructions that multiply matrices of bfloat16: by either, networks of refiners took half the time."""


class RefinedRefocuser(Refocuser):
    """A classical method and the network that corrects its pictures, without gradients.

    Args:
        refiner: Guides, pictures and doubts -> better pictures.
        base: Makes the pictures.
        names: Of the guides.
        name: As tables and legends call it.

    Raises:
        InputError: Corrections cannot be mixed of these guides.
    """

    def __init__(self, refiner: Correction, base: OperatorRefocuser, names: Sequence[str], name: str) -> None:
        check(names, refiner.n_offers)
        self.refiner = refiner.eval()
        self.base = base
        self.names = tuple(names)
        self.name = name

    def to(self, device: torch.device) -> "RefinedRefocuser":
        """As in `Refocuser`."""
        self.refiner.to(device)
        return self

    @torch.no_grad()
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The method's stack, corrected; black stays black.

        Raises:
            InputError: Views that are not finite, lie on another device or have other channels; cameras that do not
                stand on an even grid.
        """
        if positions is not None:
            raise uneven(self.name)
        like = self.refiner.like
        if views.device != like.device:
            raise InputError(f"views must be on the network's device, {like.device}", got=views.device)
        radiance = self._of_its_channels(batches.flattened(batches.radiance(views).to(like.dtype)))
        if not bool(radiance.isfinite().all()):
            raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file, or give it a weight")
        if weight is None:
            fields = [LightField(field) for field in radiance]
        else:
            trust = weight.reshape(-1, *weight.shape[-5:])
            fields = [LightField(field, weight=each) for field, each in zip(radiance, trust.to(like), strict=True)]
        stacks = torch.stack([self._of_field(field, slopes) for field in fields])
        return batches.restored(stacks.mean(-3, keepdim=True) if views.shape[-3] == 1 else stacks, views)

    def through(self, aperture: Aperture | None) -> "RefinedRefocuser":
        """As in `Refocuser`: guides look through the aperture too."""
        return RefinedRefocuser(self.refiner, self.base.through(aperture), self.names, self.name)

    def _of_its_channels(self, views: Tensor) -> Tensor:
        """Views of as many channels as the network reads; grey ones are as well coloured ones."""
        wanted, got = int(self.refiner.config["channels"]), views.shape[-3]
        if got not in (1, wanted):
            raise InputError(f"{self.name} refocuses views of {wanted} channels or one", got=got)
        return views.expand(-1, -1, -1, wanted, -1, -1)

    def _of_field(self, light: LightField, slopes: Tensor) -> Tensor:
        """A stack, [N, C, H, W]."""
        seen = Seen(light, slopes, self.base)
        n_at_once = max(1, AT_ONCE // (int(self.refiner.config["n_guides"]) * math.prod(light.size)))
        is_half = _is_half_faster(light.views.device)
        dtype = torch.bfloat16 if is_half else light.views.dtype
        with torch.autocast(light.views.device.type, torch.bfloat16, enabled=is_half):
            parts = seen.parts(n_at_once)
            return torch.cat(
                [self.refiner(guides(part, self.names, dtype), part.pictures, part.doubt) for part in parts]
            )


def _is_half_faster(device: torch.device) -> bool:
    """Whether the processor multiplies matrices of bfloat16; a correction needs no more digits."""
    told: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)() if device.type == "cpu" else {}
    return any(told.get(name) for name in MATRICES)


def payload(refiner: Correction, base: OperatorRefocuser, names: Sequence[str]) -> dict[str, Any]:
    """The entry `lfref` of a checkpoint: what builds the refocuser again.

    Args:
        refiner: The network.
        base: One of `BASES`, perhaps with options bound to it.
        names: Of the guides.

    Raises:
        InputError: Another method.
    """
    function = getattr(base.operator, "func", base.operator)
    operator = next((name for name, known in BASES.items() if known is function), None)
    if operator is None or base.aperture is not None:
        raise InputError(f"a refiner must correct one of {', '.join(BASES)}, without an aperture", got=base.name)
    options = dict(getattr(base.operator, "keywords", {}))
    told = {"name": base.name, "operator": operator, "options": options}
    return {"format": FORMAT, KIND: refiner.config, "base": told, "guides": list(names)}


def restored(path: Path, contents: Mapping[str, Any], name: str, device: str | torch.device) -> RefinedRefocuser:
    """The refocuser of a checkpoint that was read.

    Args:
        path: Of the checkpoint, for errors.
        contents: Of `checkpoint.read`.
        name: As tables and legends call it.
        device: Where the network goes.

    Raises:
        CheckpointError: It describes none that can be built, or its weights have other shapes.
    """
    entry = contents["lfref"]
    if entry.get("format") != FORMAT:
        raise CheckpointError(f"{path} must have format {FORMAT}", got=entry.get("format"), remedy="update lfref")
    try:
        refiner, (base, names) = Refiner(**entry[KIND]), described(entry)
        check(names, refiner.n_offers)
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise CheckpointError(f"{path} describes no refiner that can be built", got=error) from error
    checkpoint.load_state(path, refiner, contents["state_dict"])
    return RefinedRefocuser(refiner.to(device), base, names, name)


def described(entry: Mapping[str, Any]) -> tuple[OperatorRefocuser, list[str]]:
    """The method that is refined, and the names of the guides.

    Args:
        entry: Of `payload`.

    Raises:
        InputError: There is no such method or guide.
        KeyError: Something is not said.
        TypeError: Options that the method has not.
    """
    told, names = entry["base"], list(entry["guides"])
    operator = functools.partial(chosen("method", told["operator"], BASES), **told["options"])
    inspect.signature(operator).bind(None, None)
    for each in names:
        chosen("guide", each, GUIDES)
    return OperatorRefocuser(told["name"], operator), names
