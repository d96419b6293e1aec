"""Encodings: what is decoded is encoded again, and what names none is refused."""

import pytest
import torch

from lfref import encoding
from lfref.errors import InputError


@pytest.mark.parametrize("text", ["linear", "srgb", "gamma:2.2", "none"])
def test_what_is_decoded_is_encoded_again_and_names_itself(text):
    coded = encoding.parsed(text)
    samples = torch.linspace(-0.2, 1.5, 1001, dtype=torch.float64)
    torch.testing.assert_close(coded.encode(coded.decode(samples)), samples, atol=1e-7, rtol=1e-6)
    assert encoding.parsed(str(coded)) == coded


def test_gamma_is_a_power():
    assert float(encoding.parsed("gamma:2").decode(torch.tensor(0.5))) == 0.25


@pytest.mark.parametrize("text", ["sRGB", "gamma", "gamma:nan", "gamma:99", "linear:2"])
def test_other_names_are_refused(text):
    with pytest.raises(InputError):
        encoding.parsed(text)
