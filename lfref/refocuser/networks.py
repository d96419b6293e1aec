"""Trained networks as refocusers: networks that refocus, refiners, and the model that ships with lfref.

A network that refocuses serves the planes and the grid of its training. A refiner corrects the planes of a classical
method: it sees each plane by itself, and the views only through features, so any planes and any even grid serve.
"""

import functools
import inspect
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.errors import CheckpointError, InputError, chosen, first_line
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.network import Network
from lfref.nets.refiner import Refiner
from lfref.refocus import batches
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.scene import Scene
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.features import check_names, refiner_inputs
from lfref.refocuser.refocuser import Aperture, Operator, OperatorRefocuser, Refocuser, light_for_network

REFINER = "refiner"
"""Entry of a checkpoint that holds the network's arguments."""
REFINER_FORMAT = 1
BASES: dict[str, Operator] = {
    "blockwise_wiener": blockwise_wiener,
    "refocus_by_layers": refocus_by_layers,
    "shift_and_sum": shift_and_sum,
    "shift_and_sum_antialiased": shift_and_sum_antialiased,
}
"""Methods whose pictures may be refined, by their names in checkpoints."""
LARGEST_OPTION = 100
"""Largest number among a method's options (layers, widths in view steps): a file could ask for any amount of memory."""
AT_ONCE = 2**23
"""Samples of features that the network reads at once: those of all planes together exceed the processor's caches."""
BF16_INSTRUCTIONS = ("amx_bf16", "avx512_bf16")
"""Instructions that multiply matrices of bfloat16: with either, networks of refiners took half the time."""


class RefinedRefocuser(Refocuser):
    """A classical method `base` and the refiner that corrects its pictures by named features, without gradients."""

    is_network = True

    def __init__(self, refiner: Refiner, base: OperatorRefocuser, names: Sequence[str], name: str) -> None:
        check_names(names, refiner.n_candidates)
        self.module = self.refiner = refiner.eval()
        self.base = base
        self.names = tuple(names)
        self.name = name

    scene: Scene | None = None
    """That of the one light field that it refocuses; None: any."""

    def through(self, aperture: Aperture | None) -> "RefinedRefocuser":
        """As in `Refocuser`: the method and the features look through the aperture."""
        if aperture is None:
            return self
        return RefinedRefocuser(self.refiner, self.base.through(aperture), self.names, self.name)

    def of_scene(self, scene: Scene) -> "RefinedRefocuser":
        """As in `Refocuser`."""
        known = RefinedRefocuser(self.refiner, self.base, self.names, self.name)
        known.scene = scene
        return known

    @torch.no_grad()
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The method's stack, corrected; black stays black."""
        like = next(self.refiner.parameters())
        radiance = light_for_network(self.name, views, None, positions, like.device).to(like.dtype)
        n_channels = int(self.refiner.config["channels"])
        if views.shape[-3] not in (1, n_channels):
            raise InputError(f"{self.name} refocuses views of {n_channels} channels or one", got=views.shape[-3])
        fields = batches.flattened(radiance).expand(-1, -1, -1, n_channels, -1, -1)  # grey ones become coloured
        weights = [None] * len(fields) if weight is None else weight.reshape(-1, *weight.shape[-5:]).to(like)
        stacks = fields.new_empty(len(fields), len(slopes), *fields.shape[-3:])
        # A correction needs no more digits than bfloat16, where the processor multiplies matrices of it.
        device = stacks.device.type
        able: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)() if device == "cpu" else {}
        is_half = any(able.get(name) for name in BF16_INSTRUCTIONS)
        dtype = torch.bfloat16 if is_half else stacks.dtype
        # As many planes at once as the caches hold.
        n_at_once = max(1, AT_ONCE // (self.refiner.n_features * math.prod(fields.shape[-2:])))
        for stack, field, of_field in zip(stacks, fields, weights, strict=True):
            light = LightField(field, weight=of_field)
            is_known = self.scene is not None and weight is None and self.scene.views.shape == field.shape
            known = self.scene if is_known else None
            parts = refiner_inputs(light, slopes, self.base, self.names, n_at_once, dtype, known)
            for planes, part in zip(stack.split(n_at_once), parts, strict=True):
                with torch.autocast(device, torch.bfloat16, enabled=is_half):
                    planes.copy_(self.refiner(*part))
        return batches.restored(stacks.mean(-3, keepdim=True) if views.shape[-3] == 1 else stacks, views)


def refiner_entry(refiner: Refiner, base: OperatorRefocuser, names: Sequence[str]) -> dict[str, Any]:
    """The entry `lfref` of the checkpoint of a network that refines one of `BASES`, by these features."""
    operator = next((name for name, known in BASES.items() if known is base.function), None)
    if operator is None or base.aperture is not None:
        raise InputError(f"a refiner must correct one of {', '.join(BASES)}, without an aperture", got=base.name)
    method = {"name": base.name, "operator": operator, "options": dict(base.options)}
    return {"format": REFINER_FORMAT, REFINER: refiner.config, "base": method, "features": list(names)}


def restored_refiner(
    path: Path, contents: Mapping[str, Any], name: str, device: str | torch.device
) -> RefinedRefocuser:
    """The refocuser of a checkpoint, from what `checkpoint.read` returned; CheckpointError if it holds none."""
    entry = contents["lfref"]
    try:
        if entry["format"] != REFINER_FORMAT:
            raise CheckpointError(f"{path} must have format {REFINER_FORMAT}", got=entry["format"])
        method, names = entry["base"], entry["features"]
        for option in method["options"].values():
            for value in option if isinstance(option, list | tuple) else [option]:
                if not (value is None or isinstance(value, str) or abs(float(value)) <= LARGEST_OPTION):
                    raise InputError(f"options must be at most {LARGEST_OPTION}", got=f"{value!r:.80}")
        operator = functools.partial(chosen("method", method["operator"], BASES), **method["options"])
        inspect.signature(operator).bind(None, None)  # TypeError: options that the method has not
        refiner = checkpoint.built(path, Refiner, entry[REFINER], contents["state_dict"])
        base = OperatorRefocuser(method["name"], operator)
        refined = RefinedRefocuser(refiner.to(device), base, names, name)
    except CheckpointError:
        raise
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError, RuntimeError) as error:
        raise CheckpointError(f"{path} describes no refiner that can be built", got=first_line(error)) from error
    return refined


SHIPPED = {name: Path(__file__).parents[1] / "weights" / f"{name}.safetensors" for name in ("refiner", "refnet")}
"""Weights of the models that ship, by name; their metadata state how they were trained."""


class NetworkRefocuser(Refocuser):
    """A trained network with the planes that it was trained for, without gradients."""

    is_network = True

    def __init__(
        self, network: Network, planes: FocalPlanes, name: str | None = None, is_linear: bool | None = None
    ) -> None:
        checkpoint.check_number(network, planes)
        self.module = self.network = network.eval()
        self.name = network.name if name is None else name
        self.planes = None if network.n_planes is None else planes
        self.grid = network.grid
        self.is_linear = is_linear

    @torch.no_grad()
    def stack(self, views: Tensor, weight: Tensor | None, slopes: Tensor, positions: Tensor | None = None) -> Tensor:
        """The network's stack; integer views are scaled to [0, 1]."""
        like = next(self.network.parameters())
        radiance = light_for_network(self.name, views, weight, positions, like.device)
        return self.network(radiance.to(like.dtype), slopes).to(batches.stack_dtype(views))


def shipped_refiner(name: str = "refiner", device: str | torch.device = "cpu") -> RefinedRefocuser:
    """The model that ships with lfref: a classical method whose pictures a network corrects.

    Example:
        >>> lfref.load()(torch.rand(5, 5, 3, 48, 64), [-0.5, 0.5]).shape
        torch.Size([2, 3, 48, 64])
    """
    return restored_refiner(SHIPPED["refiner"], checkpoint.read(SHIPPED["refiner"]), name, device)


def restored_network(
    path: Path,
    contents: Mapping[str, Any],
    name: str,
    device: str | torch.device = "cpu",
    net: type[Network] | None = None,
) -> NetworkRefocuser:
    """The refocuser of a checkpoint; as `restored_refiner`, `net` being the class of a network that is not ours."""
    network, planes = checkpoint.restored(path, contents, net)
    return NetworkRefocuser(network.to(device), planes, name, contents["lfref"].get("is_linear"))


def refnet(name: str = "refnet", device: str | torch.device = "cpu") -> NetworkRefocuser:
    """The RefNet that ships with lfref: 7x7 views, the paper's 16 planes; arguments as for `refiner`."""
    return restored_network(SHIPPED["refnet"], checkpoint.read(SHIPPED["refnet"]), name, device)
