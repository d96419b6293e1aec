"""A small network, and light fields of three sizes."""

import torch

from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.nets.refnet import RefNet
from lfref.refocuser.networks import NetworkRefocuser

GRID = (3, 3)
PLANES = planes_at_alphas([0.5, 1.0, 2.0])


def field(size=(31, 45), seed=0):
    random = torch.Generator().manual_seed(seed)
    smooth = torch.nn.functional.interpolate(torch.rand(9, 3, 8, 8, generator=random), size, mode="bicubic")
    return LightField(smooth.clamp(0, 1).reshape(*GRID, 3, *size), f"drawn_{seed}")


def moving(size, seed=0):
    """Two textured surfaces, of which one moves by a pixel a view step."""
    random = torch.Generator().manual_seed(seed)
    shape = (size[0] // 3 + 2, size[1] // 3 + 2)
    far, near = torch.nn.functional.interpolate(torch.rand(2, 3, *shape, generator=random), size, mode="bicubic")
    views = torch.stack([torch.stack([near.roll((v, u), (1, 2)) for u in (-1, 0, 1)]) for v in (-1, 0, 1)])
    views[..., : size[0] // 2, :] = far[:, : size[0] // 2]
    return LightField(views.clamp(0, 1), f"moving_{seed}")


FIELDS = [field(), field((24, 32), 1), field((40, 33), 2)]


def network(shuffle=1, normalization="instance"):
    torch.manual_seed(3)
    coarse = {"shuffle": shuffle, "stem_by_colour": True, "stem_width": 15} if shuffle > 1 else {"stem_width": 16}
    net = RefNet(3, GRID, widths=(16, 8), normalization=normalization, **coarse).requires_grad_(False)
    net.initialize(FIELDS[0].views[None], None, 0.3 + 0.4 * FIELDS[0].views[None, 1])
    return NetworkRefocuser(net, PLANES, "net", is_linear=True)
