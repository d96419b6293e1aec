"""How tables and plots put columns and cells into words: headings, and digits that mean something."""

import math
import textwrap
from collections.abc import Callable
from numbers import Real
from typing import Any

# A name stays text even where it looks like a number: light field "0012" is not 12.
TEXT_COLUMNS = frozenset({"light_field", "method", "reference"})
CAP_DB = 100.0
MINUS, DASH = "\N{MINUS SIGN}", "\N{EN DASH}"

HEADINGS = {
    "light_field": "Light field",
    "method": "Method",
    "reference": "Reference",
    "alpha": "\N{GREEK SMALL LETTER ALPHA}",
    "slope": "Slope (px/view)",
    "psnr_db": "PSNR (dB)",
    "ssim": "SSIM",
    "mpsnr_db": "MPSNR (dB)",
    "mssim": "MSSIM",
    "light_fields": "Light fields",
    "job": "Job",
    "first_mpsnr_db": "First MPSNR (dB)",
    "best_mpsnr_db": "Best MPSNR (dB)",
    "median_s": "Median (s)",
    "p10_s": "P10 (s)",
    "p90_s": "P90 (s)",
    "ratio_to_numpy_fft": "Speed-up over NumPy FFT",
    "ratio_to_same_in_numpy": "Speed-up over the same in NumPy",
    "first_call_s": "First call (s)",
    "input": "Input",
    "max_error": "Largest error",
    "extra_bytes": "Extra memory (MB)",
    "memory_ratio": "Peak / allowed memory",
    "component": "Component",
    "case": "Case",
    "precision": "Precision",
    "formulation": "Formulation",
    "outcome": "Outcome",
    "error": "Error",
    "times_allowed": "Times what is allowed",
    "figure": "Figure",
    "goal": "Goal",
    "measured": "Measured",
    "usual": "Usual form",
    "holds": "Holds",
    "exponent_pixels": "Exponent in pixels",
    "exponent_views": "Exponent in views",
    "exponent_planes": "Exponent in planes",
}


def heading(column: str) -> str:
    """What people read above a column or along an axis."""
    return HEADINGS.get(column, column)


def drawable(name: object, width: int = 28) -> str:
    """A user's name as matplotlib should draw it: wrapped after words and underscores, `$` being no formula."""
    wrapped = textwrap.fill(str(name).replace("_", "_ "), width).replace("_ ", "_").replace("$", r"\$")
    return f" {wrapped}" if wrapped.startswith("_") else wrapped  # matplotlib hides labels that begin with _


def cell_for_people(column: str, value: Any) -> str:
    """A cell as people read it: digits that mean something, a dash for nothing, a true minus sign."""
    if value is None or value == "" or (is_real(value) and math.isnan(value)):
        return DASH
    if not is_real(value) or column in TEXT_COLUMNS:
        return str(value)
    return _FORMATS.get(column, _plain)(value).replace("-", MINUS).replace("inf", "∞")


def is_real(value: Any) -> bool:
    """Whether a cell holds a number, NaN and infinity among them."""
    return isinstance(value, Real) and not isinstance(value, bool)


def _plain(value: float) -> str:
    whole = isinstance(value, int) or 1e4 <= abs(value) < 1e15
    return f"{value:,.0f}" if whole else f"{value:.4g}"


def _decibel(value: float) -> str:
    return f"≥ {CAP_DB:.0f}" if value >= CAP_DB else f"{value:.2f}"


def _short(value: float) -> str:
    return f"{value:.0f}" if 1000 <= abs(value) < 1e15 else f"{value:#.3g}".rstrip(".")


def _times(value: float) -> str:
    return f"{_short(value)}\N{MULTIPLICATION SIGN}"


_FORMATS: dict[str, Callable[[float], str]] = {
    "alpha": "{:.3f}".format,
    "slope": "{:.3f}".format,
    "psnr_db": _decibel,
    "mpsnr_db": _decibel,
    "first_mpsnr_db": _decibel,
    "best_mpsnr_db": _decibel,
    "ssim": "{:.4f}".format,
    "mssim": "{:.4f}".format,
    "median_s": _short,
    "p10_s": _short,
    "p90_s": _short,
    "first_call_s": _short,
    "ratio_to_numpy_fft": _times,
    "ratio_to_same_in_numpy": _times,
    "max_error": "{:.1e}".format,
    "extra_bytes": lambda value: _short(value / 1e6),
    "memory_ratio": "{:.2f}".format,
    "measured": "{:.3g}".format,
    "usual": "{:.3g}".format,
    "exponent_pixels": "{:.2f}".format,
    "exponent_views": "{:.2f}".format,
    "exponent_planes": "{:.2f}".format,
}
