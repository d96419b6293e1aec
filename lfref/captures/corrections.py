"""The defects that are looked for, in the order in which they are taken off: the reverse of the light's way."""

from lfref.captures.correction import Correction

CORRECTIONS: tuple[Correction, ...] = ()
"""Each is looked for in the field that those before it have put right."""
