"""Other programs on the same work: 16 planes of our path-traced scenes, and the time of the paper's size.

A worker runs each program in an environment of its own below `runs/compare`, and lfref in this one.
"""

import os
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path

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
while len(times) < int(sys.argv[2]) and sum(times) < 60:
    start = time.perf_counter()
    stack = {call}
    times.append(time.perf_counter() - start)
np.savez(folder + "/result.npz", stack=np.asarray(stack, np.float32), times=times)
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


OLD = "numpy<2 scipy<1.14"
OF_PLENPY = (f"plenpy==0.9.2 {OLD}",)
OF_PLENOPTICAM = (
    f"tifffile==2022.4.8 scikit-image==0.20 requests colour-demosaicing<0.2.4 depthy {OLD}",
    "--no-deps plenopticam==0.9.3 color-space-converter color-matcher",
)
OF_PLENOPTOMOS = f"matplotlib h5py pillow imageio tqdm {OLD}", "--no-deps git+https://github.com/cicwi/plenoptomos"
OURS = "shift_and_sum", "shift_and_sum_antialiased", "separable_wiener", "blockwise_wiener"
PROGRAMS = {
    "plenpy 0.9.2, linear": (PLENPY, "refocus()", OF_PLENPY),
    "plenpy 0.9.2, cubic splines": (PLENPY, "refocus(splines())", OF_PLENPY),
    "PlenoptiCam 0.9.3, whole steps": (PLENOPTICAM, "refocus()", OF_PLENOPTICAM),
    "plenoptomos 0.2.0, integration": (PLENOPTOMOS, "refocus()", OF_PLENOPTOMOS),
    **{f"lfref, {name}": (LFREF.replace("{method}", name), f'refocus("{name}")', ()) for name in OURS},
}
"""What is set up, what is timed, and what pip installs, call by call (nothing: it runs in this environment)."""


def python_of(place: Path, packages: tuple[str, ...]) -> str:
    """The interpreter of an environment with packages, which is made on first use."""
    python = str(place / "bin" / "python") if packages else sys.executable
    if packages and not (place / "complete").exists():
        venv.create(place, with_pip=True)
        for words in packages:
            subprocess.run([python, "-m", "pip", "install", "--quiet", *words.split()], check=True)
        (place / "complete").touch()
    return python


def refocused(title: str, views: torch.Tensor, slopes: torch.Tensor, repeats: int) -> tuple[torch.Tensor, float]:
    """The stack of a program, [N, C, H, W], and its median time in seconds."""
    folder = RUN / "work"
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "views.npy", views.permute(0, 1, 3, 4, 2).float().numpy())
    np.save(folder / "slopes.npy", slopes.double().numpy())
    setup, call, packages = PROGRAMS[title]
    python, code = python_of(RUN / title.split()[0], packages), WORKER.format(setup=setup, call=call)
    threads = os.environ | {"OMP_NUM_THREADS": "2"}
    command = [python, "-c", code, str(folder), str(repeats)]
    subprocess.run(command, check=True, cwd=folder, stdout=subprocess.DEVNULL, env=threads)
    result = np.load(folder / "result.npz")
    return torch.from_numpy(result["stack"]).permute(0, 3, 1, 2), float(np.median(result["times"]))


def table() -> Iterator[str]:
    """Mean PSNR over the scenes that are complete, and the time of 16 planes of the paper's size."""
    scenes = [judges.judged(name) for name in judges.complete()]
    views, planes, *_ = scenes[0]
    # The first scene, enlarged: times of some methods depend on what views show.
    large = F.interpolate(views.flatten(0, 1), pages.SIZE, mode="bilinear").unflatten(0, views.shape[:2])
    yield from pages.head("program", "PSNR, dB", "seconds")
    for title in PROGRAMS:
        scores = [judges.score(refocused(title, views, slopes, 1)[0], *truths) for views, slopes, *truths in scenes]
        seconds = refocused(title, large, planes, REPEATS)[1]
        yield pages.row(title, f"{np.mean(scores):.1f}", f"{seconds:.2g}")
    yield ""
    yield f"PSNR against the truth, mean of {len(scenes)} path-traced scenes, 16 planes each; seconds for 16 planes"
    yield f"of 7x7x3x{pages.SIZE[0]}x{pages.SIZE[1]}, median of {REPEATS}, or one of"
    yield f"more than a minute; {pages.machine(timing.facts(pages.CPU))}."


if __name__ == "__main__":
    pages.fill({"compare": table()})
