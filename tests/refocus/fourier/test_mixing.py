import pytest
import torch

from lfref.refocus.fourier import layer_mixing
from lfref.refocus.fourier.layer_mixing import Matrices

SIZE = (7, 21)  # of the spectra: no multiple of what a compiled loop takes at a time


def definite(n, dtype):
    """Matrices n x n whose sum with a diagonal of 4 n is Hermitian and positive definite."""
    rows, columns = torch.rand(n, n, 2, SIZE[0], dtype=dtype), torch.rand(n, n, 2, SIZE[1], dtype=dtype)
    return Matrices(rows + rows.transpose(0, 1).conj(), (columns + columns.transpose(0, 1).conj()))


def spectra(n, dtype=torch.complex128):
    return torch.randn(2, n, 3, *SIZE, dtype=dtype)


def at_every_frequency(matrices):
    return torch.einsum("mnty,mntx->mnyx", matrices.rows, matrices.columns)


@pytest.mark.parametrize("dtype", [torch.float64, torch.complex128])
def test_products_are_those_of_the_matrices_written_out(dtype):
    matrices = Matrices(torch.randn(4, 3, 2, SIZE[0], dtype=dtype), torch.randn(4, 3, 2, SIZE[1], dtype=dtype))
    given = spectra(3)
    expected = torch.einsum("mnyx,bncyx->bmcyx", at_every_frequency(matrices).to(given), given)
    torch.testing.assert_close(layer_mixing.multiply(given, matrices), expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float64, torch.complex128])
def test_solutions_multiplied_are_what_was_given(dtype):
    matrices, given, diagonal = definite(5, dtype), spectra(5), torch.linspace(30, 40, 5, dtype=torch.float64)
    found = layer_mixing.solve(given, matrices, diagonal)
    again = layer_mixing.multiply(found, matrices) + diagonal[:, None, None, None] * found
    torch.testing.assert_close(again, given, atol=1e-12, rtol=0)


def test_compiled_loops_and_pytorch_agree():
    matrices, given, diagonal = definite(5, torch.float64), spectra(5), torch.full((5,), 30.0, dtype=torch.float64)
    asked = given.clone().requires_grad_()
    for step in (layer_mixing.multiply, lambda *arguments: layer_mixing.solve(*arguments, diagonal)):
        torch.testing.assert_close(step(asked, matrices).detach(), step(given, matrices), atol=1e-13, rtol=0)


def test_any_memory_layout_and_float32():
    matrices, given = definite(3, torch.float64), spectra(3, torch.complex64)
    turned = given.movedim(1, -1).contiguous().movedim(-1, 1)
    expected = layer_mixing.multiply(given.to(torch.complex128), matrices)
    assert layer_mixing.multiply(turned, matrices).dtype == torch.complex64
    torch.testing.assert_close(layer_mixing.multiply(turned, matrices).to(expected), expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(
        layer_mixing.multiply(given.conj(), matrices), layer_mixing.multiply(given, matrices).conj()
    )


def test_products_and_differences_of_matrices_go_element_by_element():
    first, second = definite(3, torch.float64), definite(3, torch.float64)
    a, b = at_every_frequency(first), at_every_frequency(second)
    torch.testing.assert_close(at_every_frequency(first.times(second)), a * b)
    torch.testing.assert_close(at_every_frequency(first.minus(second)), a - b)
