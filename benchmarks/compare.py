"""Other programs on the same work: 16 planes of our path-traced scenes by the truth, and the time of the paper's size.

Each program is installed into an environment of its own below `runs/compare`; a worker runs there, reads views and
slopes, and writes its stack and its times. lfref takes part in the same way.
"""

import os
import statistics
import subprocess
import sys
import venv
from collections.abc import Iterator
from typing import NamedTuple

import judges
import numpy as np
import pages
import torch
from torch.nn import functional as F

from lfref.bench import timing

RUN = pages.ROOT / "runs" / "compare"
REPEATS = 3
WORKER = """
import sys, time
import numpy as np
folder = sys.argv[1]
views, slopes = np.load(folder + "/views.npy"), np.load(folder + "/slopes.npy")
{setup}
times = []
for _ in range(int(sys.argv[2])):
    start = time.perf_counter()
    stack = {call}
    times.append(time.perf_counter() - start)
    if sum(times) > 60:
        break
np.save(folder + "/stack.npy", np.asarray(stack, np.float32))
np.save(folder + "/times.npy", times)
"""
"""Views [V, U, H, W, C] and slopes [N] in, stack [N, H, W, C] out."""
PLENPY = """
from scipy import interpolate
from plenpy.lightfields import LightField
field = LightField(views)
n = len(views)  # it spreads n views over n steps
y, x = np.arange(views.shape[2]), np.arange(views.shape[3])
def splines():
    return np.array([[[interpolate.interp2d(y, x, views[v, u, :, :, c].T, kind="cubic") for c in range(3)]
                      for v in range(n)] for u in range(n)], dtype=object)
def refocus(between=None):
    return field.get_refocus(-slopes * (n - 1) / n, pre_interpolation=between).transpose(3, 0, 1, 2)
"""
PLENOPTICAM = """
from plenopticam.cfg import PlenopticamConfig
from plenopticam.lfp_refocuser import LfpShiftAndSum
from plenopticam.misc import PlenopticamStatus
cfg = PlenopticamConfig(); cfg.default_values()
cfg.params[cfg.ptc_leng], cfg.params[cfg.opt_refi], cfg.params[cfg.opt_prnt] = len(views), False, False
whole = np.rint(slopes).astype(int)
def refocus():
    planes = {}
    for slope in sorted(set(whole)):
        cfg.params[cfg.ran_refo] = [-slope, -slope + 1]
        one = LfpShiftAndSum(vp_img_arr=views.astype(np.float64), cfg=cfg, sta=PlenopticamStatus())
        one.refo_from_vp()
        planes[slope] = one._refo_stack[0] / len(views)
    return [planes[slope] for slope in whole]
"""
PLENOPTOMOS = """
np.int = int  # NumPy once had this name
from plenoptomos import lightfield
from plenoptomos.refocus import compute_refocus_integration
camera = lightfield.Camera()
camera.data_size_vu, camera.data_size_ts = np.array(views.shape[:2]), np.array(views.shape[2:4])
camera.pixel_size_vu, camera.pixel_size_ts, camera.z1, camera.f1 = np.ones(2), np.full(2, 0.1), 1.0, 0.5
def refocus():
    fields = [lightfield.Lightfield(camera.clone(), views[..., c], mode="sub-aperture") for c in range(3)]
    # It shifts by 1 - 1 / distance in units of 10 pixels.
    options = dict(domain="image", border=int(np.ceil(len(views) / 2 * np.abs(slopes).max())))
    return np.stack([compute_refocus_integration(one, 1 / (1 - slopes / 10), **options) for one in fields], -1)
"""
LFREF = """
import torch, lfref
field = torch.from_numpy(views).permute(0, 1, 4, 2, 3).contiguous()
def refocus(method):
    with torch.no_grad():
        return getattr(lfref, method)(field, slopes).permute(0, 2, 3, 1).numpy()
refocus("{method}")  # compiles loops
"""


class Program(NamedTuple):
    """A method of a program: what pip installs with its dependencies (nothing: this environment), and without them."""

    packages: tuple[str, ...]
    setup: str
    call: str
    extra: tuple[str, ...] = ()


OLD = ("numpy<2", "scipy<1.14")
PROGRAMS = {
    "plenpy 0.9.2, linear": Program(("plenpy==0.9.2", *OLD), PLENPY, "refocus()"),
    "plenpy 0.9.2, cubic splines": Program(("plenpy==0.9.2", *OLD), PLENPY, "refocus(splines())"),
    "PlenoptiCam 0.9.3, whole steps": Program(
        ("tifffile==2022.4.8", "scikit-image==0.20", "requests", "colour-demosaicing<0.2.4", "depthy", *OLD),
        PLENOPTICAM,
        "refocus()",
        ("plenopticam==0.9.3", "color-space-converter", "color-matcher"),
    ),
    "plenoptomos 0.2.0, integration": Program(
        ("matplotlib", "h5py", "pillow", "imageio", "tqdm", *OLD),
        PLENOPTOMOS,
        "refocus()",
        ("git+https://github.com/cicwi/plenoptomos",),
    ),
    **{
        f"lfref, {method}": Program((), LFREF.replace("{method}", method), f'refocus("{method}")')
        for method in ("shift_and_sum", "shift_and_sum_antialiased", "separable_wiener", "blockwise_wiener")
    },
}


def python_of(program: Program) -> str:
    """The interpreter of an environment with the packages of a program, which is made on first use."""
    if not program.packages:
        return sys.executable
    place = RUN / program.packages[0].partition("=")[0]
    python = str(place / "bin" / "python")
    if not (place / "installed").exists():
        venv.create(place, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *program.packages], check=True)
        if program.extra:
            subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-deps", *program.extra], check=True)
        (place / "installed").touch()
    return python


def refocused(program: Program, views: torch.Tensor, slopes: torch.Tensor, repeats: int) -> tuple[torch.Tensor, float]:
    """The stack of a program, [N, C, H, W], and its median time in seconds."""
    folder = RUN / "work"
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "views.npy", views.permute(0, 1, 3, 4, 2).float().numpy())
    np.save(folder / "slopes.npy", slopes.double().numpy())
    code = WORKER.format(setup=program.setup, call=program.call)
    command = [python_of(program), "-c", code, str(folder), str(repeats)]
    subprocess.run(
        command, check=True, cwd=folder, stdout=subprocess.DEVNULL, env=os.environ | {"OMP_NUM_THREADS": "2"}
    )
    stack = torch.from_numpy(np.load(folder / "stack.npy")).permute(0, 3, 1, 2)
    return stack, statistics.median(np.load(folder / "times.npy"))


def table() -> Iterator[str]:
    """Mean PSNR over the scenes that are complete, and the time of 16 planes of the paper's size."""
    names = judges.complete()
    views, planes, *_ = judges.judged(names[0])
    # The first scene, enlarged: times of some methods depend on what views show.
    large = F.interpolate(views.flatten(0, 1), pages.SIZE, mode="bilinear").unflatten(0, views.shape[:2])
    yield from pages.head("program", "PSNR, dB", "seconds")
    for title, program in PROGRAMS.items():
        scores = []
        for name in names:
            views, slopes, first, second = judges.judged(name)
            scores.append(judges.score(refocused(program, views, slopes, 1)[0], first, second))
        seconds = refocused(program, large, planes, REPEATS)[1]
        yield pages.row(title, f"{statistics.mean(scores):.1f}", f"{seconds:.2g}")
    yield ""
    yield f"PSNR by the truth, mean of {len(names)} path-traced scenes, 16 planes each; seconds for 16 planes"
    yield f"of 7x7x3x{pages.SIZE[0]}x{pages.SIZE[1]}, median of {REPEATS}, or one of"
    yield f"more than a minute; {pages.machine(timing.facts(pages.CPU))}."


if __name__ == "__main__":
    pages.fill({"compare": table()})
