"""Which effects a scene's optics and sensor have."""

from dataclasses import dataclass
from typing import get_args, get_type_hints

from lfref.encoding import LINEAR, Encoding
from lfref.simulator import checks
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.displacement import Chromatic, Misalignment
from lfref.simulator.effects.mosaic import Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.response import Clipping, Exposure, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.vignetting import Vignetting


@dataclass(frozen=True)
class Sensor:
    """One optional effect a field, in the order in which light meets them; None is off.

    The lens makes the pictures and shades them, lenslets beside their place displace and mix them, the exposure
    collects them. From mosaic to quantisation the samples are raw, one colour a pixel where there is a mosaic. What
    software does with raw samples comes last.
    """

    chromatic: Chromatic | None = None
    vignetting: Vignetting | None = None
    misalignment: Misalignment | None = None
    crosstalk: Crosstalk | None = None
    exposure: Exposure | None = None
    mosaic: Mosaic | None = None
    noise: Noise | None = None
    clipping: Clipping | None = None
    quantisation: Quantisation | None = None
    white_balance: WhiteBalance | None = None
    tone_curve: ToneCurve | None = None

    def __post_init__(self) -> None:
        for name, effect in EFFECTS.items():
            if (value := getattr(self, name)) is not None:
                checks.kind(f"a sensor's {name}", value, effect)

    @property
    def encoding(self) -> Encoding:
        """How the samples of its views stand for light."""
        return LINEAR if self.tone_curve is None else self.tone_curve.encoding


EFFECTS: dict[str, type] = {name: get_args(hint)[0] for name, hint in get_type_hints(Sensor).items()}
"""What each field of a sensor holds."""
