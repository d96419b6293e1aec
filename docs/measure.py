"""Measure the figures that the README and these pages quote, and write them between their markers.

Run by `make figures`, after `lfref bench` has left its table; a marker is `<!-- measured: NAME -->` ... `<!-- end -->`.
"""

import functools
import json
import re
from collections.abc import Iterator
from pathlib import Path

import torch

from lfref.data.labels import LabelSource
from lfref.data.patches import cut
from lfref.data.sources import SimulatedSource
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.refocus.fourier_slice import fourier_slice
from lfref.report import tables

ROOT = Path(__file__).resolve().parents[1]
BENCH = ROOT / "runs" / "figures" / "bench"
PAPER = FocalPlanes(tuple(step / 8 for step in range(1, 17)))
PATCH, FIELD = 192, 256


def bench() -> Iterator[str]:
    """Time and accuracy of every operator setting, from the table of `lfref bench`."""
    facts = json.loads((BENCH / "machine.json").read_text())
    yield "| method | median, s | times faster than NumPy's 4-D FFT | PSNR against exact, dB | SSIM |"
    yield "|---|---|---|---|---|"
    for row in tables.read_table(BENCH / "bench.csv"):
        quality = ("", "") if row["psnr_db"] is None else (f"{row['psnr_db']:.1f}", f"{row['ssim']:.4f}")
        cells = (row["method"], f"{row['median_s']:.2f}", f"{row['ratio_to_numpy_fft']:.2f}", *quality)
        yield f"| {' | '.join(cells)} |"
    yield ""
    yield f"One simulated light field, 7x7x3x375x540, 16 planes; {facts['processor']}, {facts['threads']} threads,"
    yield f"torch {facts['torch']}, NumPy {facts['numpy']}, {facts['repeats']} rounds. PSNR is capped at 100 dB."


def patch_labels() -> Iterator[str]:
    """How far a patch's Fourier-slice label is from that part of the whole field's label."""
    source = LabelSource("fourier_slice", functools.partial(fourier_slice, width=4, padding=2), PAPER)
    start = (FIELD - PATCH) // 2
    yield "| place of the patch | mean PSNR over the planes, dB | worst plane, dB |"
    yield "|---|---|---|"
    for place, corner in (("middle of the field", start), ("corner of the field", 0)):
        values = torch.cat([_label_psnr(source, index, corner) for index in range(4)])
        yield f"| {place} | {values.mean():.1f} | {values.min():.1f} |"
    yield ""
    yield f"Four simulated fields of {FIELD}x{FIELD}, patches of {PATCH}x{PATCH}, the paper's planes,"
    yield "Kaiser-Bessel width 4, padded twice."


FIGURES = {"bench": bench, "patch_labels": patch_labels}


def _label_psnr(source: LabelSource, index: int, corner: int) -> torch.Tensor:
    field = SimulatedSource(4, 0, (FIELD, FIELD)).field(index)
    _, label = cut(field, source, corner, corner, PATCH)
    window = (..., slice(corner, corner + PATCH), slice(corner, corner + PATCH))
    return psnr(label, source(field)[window])


def main() -> None:
    """Fill every marker of the README and the pages beside this file."""
    measured = {name: "\n".join(lines()) for name, lines in FIGURES.items()}
    for page in (ROOT / "README.md", *sorted(Path(__file__).parent.glob("*.md"))):
        text = page.read_text("utf-8")
        filled = re.sub(
            r"(<!-- measured: (\w+) -->\n).*?(<!-- end -->)",
            lambda found: f"{found[1]}{measured[found[2]]}\n{found[3]}",
            text,
            flags=re.DOTALL,
        )
        if filled != text:
            atomic.write_text(page, filled)
            print(f"wrote {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
