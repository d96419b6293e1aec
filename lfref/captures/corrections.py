"""The defects that are looked for, in the order in which they are taken off: the reverse of the light's way."""

from lfref.captures.alignment import ALIGNMENT
from lfref.captures.black_views import BLACK_VIEWS
from lfref.captures.chromatic import CHROMATIC
from lfref.captures.correction import Correction
from lfref.captures.exposure import EXPOSURE
from lfref.captures.hot_pixels import HOT_PIXELS
from lfref.captures.noise import NOISE
from lfref.captures.spacing import SPACING
from lfref.captures.vignetting import VIGNETTING

CORRECTIONS: tuple[Correction, ...] = (
    HOT_PIXELS,
    BLACK_VIEWS,
    VIGNETTING,
    EXPOSURE,
    CHROMATIC,
    ALIGNMENT,
    SPACING,
    NOISE,
)
"""Each is looked for in the field that those before it have put right; noise is told and never taken off."""
