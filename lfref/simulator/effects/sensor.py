"""Which effects a scene's optics and sensor have."""

from dataclasses import dataclass, fields

from lfref.simulator import checks
from lfref.simulator.effects.chromatic import Chromatic
from lfref.simulator.effects.clipping import Clipping
from lfref.simulator.effects.crosstalk import Crosstalk
from lfref.simulator.effects.exposure import Exposure
from lfref.simulator.effects.misalignment import Misalignment
from lfref.simulator.effects.mosaic import Mosaic
from lfref.simulator.effects.noise import Noise
from lfref.simulator.effects.quantisation import Quantisation
from lfref.simulator.effects.tone_curve import ToneCurve
from lfref.simulator.effects.vignetting import Vignetting
from lfref.simulator.effects.white_balance import WhiteBalance

EFFECTS: tuple[type, ...] = (
    Chromatic, Vignetting, Misalignment, Crosstalk, Exposure, Mosaic, Noise, Clipping, Quantisation, WhiteBalance,
    ToneCurve,
)  # fmt: skip
"""What the fields of `Sensor` hold, in their order."""


@dataclass(frozen=True)
class Sensor:
    """One optional effect a field, in the order in which light meets them; None is off."""

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
        for field, effect in zip(fields(self), EFFECTS, strict=True):
            if (value := getattr(self, field.name)) is not None:
                checks.kind(f"a sensor's {field.name}", value, effect)
