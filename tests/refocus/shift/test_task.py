import pytest
import torch

from lfref.errors import InputError
from lfref.refocus.shift import shift_torch

GRID, SIZE = (3, 5), (20, 24)


def test_shifts_grow_with_the_distance_from_the_angular_centre():
    shifts = shift_torch.plan([0.5], GRID, SIZE).planes[0]
    assert shifts.rows == (-0.5, 0.0, 0.5)
    assert shifts.columns == ((-1.0, -0.5, 0.0, 0.5, 1.0),)
    assert shift_torch.plan([0.5], GRID, SIZE, "nearest").planes[0].rows == (0, 0, 1)


def test_cameras_at_columns_of_their_own_shift_by_them():
    positions = torch.zeros(2, 2, 2, dtype=torch.float64)
    positions[..., 0], positions[..., 1] = torch.tensor([[-1], [1]]), torch.tensor([[-1, 2], [0.5, 3]])
    planned = shift_torch.plan([0.5], (2, 2), SIZE, positions=positions)
    assert planned.planes[0].rows == (-0.5, 0.5)
    assert planned.planes[0].along_row(1) == (0.25, 1.5)
    assert not planned.is_separable
    assert planned.reach == 3
    positions[0, 0, 0] = 0  # no row any more: each view is a line
    planned = shift_torch.plan([0.5], (2, 2), SIZE, weights=torch.tensor([[1.0, 1], [0, 2]]), positions=positions)
    assert planned.aperture == ((0.25,), (0.25,), (0.0,), (0.5,))
    assert planned.planes[0].columns == ((-0.5,), (1.0,), (0.25,), (1.5,))


def test_reach_covers_every_tap():
    for slope in (-2.5, -0.3, 0.0, 1.0, 2.9):
        planned = shift_torch.plan([slope, 0.0], GRID, SIZE, "cubic")
        taken = [tap for tap in planned.interpolation.taps(2 * slope) if tap[1] != 0]
        first, last = min(offset for offset, _ in taken), max(offset for offset, _ in taken)
        spans = planned.span(2 * slope, 1)
        assert spans[0] + first >= -planned.reach
        assert spans[1] - 1 + last < SIZE[1] + planned.reach


@pytest.mark.parametrize(
    ("border", "expected"),
    [("edge", [0, 0, 0, 1, 2, 3, 3, 3]), ("wrap", [2, 3, 0, 1, 2, 3, 0, 1]), ("zero", [-1, -1, 0, 1, 2, 3, -1, -1])],
)
def test_beyond_the_edge_stands_what_the_border_puts_there(border, expected):
    assert shift_torch.plan([0.5], GRID, (4, 4), border=border).beyond(0).tolist() == expected


def test_only_renormalize_narrows_the_span_of_a_shifted_view():
    assert shift_torch.plan([0.5], GRID, SIZE).span(1.5, 0) == (0, 18)
    assert shift_torch.plan([0.5], GRID, SIZE).span(-1.5, 1) == (2, 24)
    assert shift_torch.plan([0.5], GRID, SIZE, border="edge").span(1.5, 0) == (0, 20)


def test_factors_are_one_over_the_coverage():
    planned = shift_torch.plan([2.0], GRID, SIZE)
    covered = planned.coverage(planned.planes[0])
    torch.testing.assert_close(planned.factors(planned.planes[0]) * covered, torch.ones(SIZE, dtype=torch.float64))
    assert bool((shift_torch.plan([2.0], GRID, SIZE, border="zero").factors(planned.planes[0]) == 1).all())


def test_a_pixel_that_no_open_view_covers_has_factor_0():
    corner = torch.zeros(GRID)
    corner[0, 0] = 1
    planned = shift_torch.plan([2.0], GRID, SIZE, weights=corner)
    factors = planned.factors(planned.planes[0])
    assert bool((factors[:2] == 0).all())
    assert bool((factors[:, :4] == 0).all())
    assert bool((factors[2:, 4:] == 1).all())


def test_equal_tasks_are_one_key():
    assert hash(shift_torch.plan([0.3, 1], GRID, SIZE)) == hash(
        shift_torch.plan(torch.tensor([0.3, 1], dtype=torch.float64), GRID, SIZE)
    )


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(InputError, match="interpolation must be one of"):
        shift_torch.plan([0.3], GRID, SIZE, "magic")
    with pytest.raises(InputError, match="border must be one of"):
        shift_torch.plan([0.3], GRID, SIZE, border="mirror")
