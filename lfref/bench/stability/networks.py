"""RefNet with every activation and normalisation of the ablations as components: 11 blocks on degenerate views.

Narrow networks behave as wide ones do here: what fails is the depth, on constants.
"""

import copy

import torch
from torch import Tensor, nn

from lfref.bench.stability import catalogue, usual
from lfref.bench.stability.trials import OURS, Component, Precision
from lfref.nets.blocks import ACTIVATIONS, NORMALIZATIONS
from lfref.nets.refnet import RefNet

WIDTHS = (32,) * 11
N_PLANES = 2
USUAL = "textbook"


def components() -> list[Component]:
    """Each activation with instance normalisation, and softplus with each normalisation."""
    choices = [(activation, "instance") for activation in ACTIVATIONS]
    choices += [("softplus", normalization) for normalization in NORMALIZATIONS if normalization != "instance"]
    return [_component(*choice) for choice in choices]


def network(activation: str = "softplus", normalization: str = "instance", seed: int = 0) -> RefNet:
    """A narrow RefNet of 11 blocks with random weights.

    Args:
        activation: As in `RefNet`.
        normalization: As in `RefNet`.
        seed: Of the weights.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return RefNet(
            n_planes=N_PLANES,
            grid=catalogue.NETWORK_GRID,
            activation=activation,
            normalization=normalization,
            widths=WIDTHS,
            stem_width=WIDTHS[0],
        )


def _component(activation: str, normalization: str) -> Component:
    ours = network(activation, normalization)
    formulations: dict[str, nn.Module] = {OURS: ours, USUAL: usual.rewritten(copy.deepcopy(ours))}
    exact = copy.deepcopy(ours).double()
    name = f"RefNet, {activation}, {normalization} norm"
    return Component(name, catalogue.NETWORK_VIEWS, formulations, exact, _allowed, free=(USUAL,))


def _allowed(right: Tensor, precision: Precision, *views: Tensor) -> Tensor:
    """Float32 must be right; of half types only that they stay finite can be asked, 11 blocks deep."""
    is_float32 = precision == Precision(torch.float32)
    return torch.full_like(right, 1e-3 * float(right.nan_to_num(0, 0, 0).abs().max()) if is_float32 else torch.inf)
