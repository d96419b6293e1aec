"""lfref: classical and learned light-field refocusing.

The public names load on first use, so that `import lfref` brings in nothing but PyTorch.
"""

import importlib
from typing import Any

__version__ = "0.3.0"

_HOMES = {
    "LightField": "lfref.lightfield",
    "slopes": "lfref.geometry",
    "FocalPlanes": "lfref.geometry",
    "even_planes": "lfref.geometry",
    "planes_at_alphas": "lfref.geometry",
    "read": "lfref.io.read",
    "write": "lfref.io.write",
    "inspect": "lfref.captures.inspect",
    "shift_and_sum": "lfref.refocus.shift.shift_and_sum",
    "shift_and_sum_antialiased": "lfref.refocus.shift.shift_and_sum_antialiased",
    "shift_and_median": "lfref.refocus.shift.shift_and_median",
    "exact_fourier": "lfref.refocus.fourier.exact",
    "fourier_slice": "lfref.refocus.fourier.slice",
    "focal_stack_transform": "lfref.refocus.fourier.focal_stack_transform",
    "disparity_layers": "lfref.refocus.fourier.disparity_layers",
    "refocus_by_layers": "lfref.refocus.fourier.disparity_layers",
    "separable_wiener": "lfref.refocus.separable_wiener",
    "blockwise_wiener": "lfref.refocus.blockwise_wiener",
    "tilt_shift": "lfref.refocus.surface",
    "per_pixel": "lfref.refocus.surface",
    "homography": "lfref.refocus.surface",
    "super_resolve": "lfref.refocus.fourier.super_resolution",
    "all_in_focus": "lfref.refocus.focus.all_in_focus",
    "extended_focus": "lfref.refocus.focus.all_in_focus",
    "disparity_map": "lfref.refocus.disparity.disparity_map",
    "correct": "lfref.captures.correct",
    "adjoint": "lfref.refocus.operator",
    "analyze_scene": "lfref.refocus.scene",
    "OperatorRefocuser": "lfref.refocuser.refocuser",
    "simulate": "lfref.simulator.simulate",
    "RefNet": "lfref.nets.refnet",
    "load": "lfref.refocuser.load",
    "CompositeLoss": "lfref.losses.composite",
    "ssim": "lfref.functional.ssim",
    "psnr": "lfref.functional.psnr",
    "LfrefError": "lfref.errors",
}
__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'lfref' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
