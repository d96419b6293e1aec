import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import lines
from lfref.refocus.shift import shift_plan

GRID, SIZE = (3, 5), (20, 24)


def planned(slopes, grid=GRID, size=SIZE, *names, positions=None, **options):
    planes = lines.checked_slopes(slopes, grid, size, positions)
    return shift_plan.plan(planes, grid, size, *names, positions=positions, **options)


def test_shifts_grow_with_the_distance_from_the_angular_centre():
    shifts = planned([0.5], GRID, SIZE).planes[0]
    assert shifts.rows == (-0.5, 0.0, 0.5)
    assert shifts.columns == ((-1.0, -0.5, 0.0, 0.5, 1.0),)
    assert planned([0.5], GRID, SIZE, "nearest").planes[0].rows == (0, 0, 1)


def test_cameras_at_columns_of_their_own_shift_by_them():
    positions = torch.zeros(2, 2, 2, dtype=torch.float64)
    positions[..., 0], positions[..., 1] = torch.tensor([[-1], [1]]), torch.tensor([[-1, 2], [0.5, 3]])
    plan = planned([0.5], (2, 2), SIZE, positions=positions)
    assert plan.planes[0].rows == (-0.5, 0.5)
    assert plan.planes[0].columns == ((-0.5, 1.0), (0.25, 1.5))
    assert not plan.is_separable
    assert plan.reach == 3
    positions[0, 0, 0] = 0  # no row any more: each view is a line
    plan = planned([0.5], (2, 2), SIZE, weights=torch.tensor([[1.0, 1], [0, 2]]), positions=positions)
    assert plan.aperture == ((0.25,), (0.25,), (0.0,), (0.5,))
    assert plan.planes[0].columns == ((-0.5,), (1.0,), (0.25,), (1.5,))


def test_reach_covers_every_tap():
    for slope in (-2.5, -0.3, 0.0, 1.0, 2.9):
        plan = planned([slope, 0.0], GRID, SIZE, "cubic")
        taken = [tap for tap in plan.interpolation.taps(2 * slope) if tap[1] != 0]
        first, last = min(offset for offset, _ in taken), max(offset for offset, _ in taken)
        spans = plan.span(2 * slope, 1)
        assert spans[0] + first >= -plan.reach
        assert spans[1] - 1 + last < SIZE[1] + plan.reach


def test_only_renormalize_narrows_the_span_of_a_shifted_view():
    assert planned([0.5], GRID, SIZE).span(1.5, 0) == (0, 18)
    assert planned([0.5], GRID, SIZE).span(-1.5, 1) == (2, 24)
    assert planned([0.5], GRID, SIZE, border="edge").span(1.5, 0) == (0, 20)


def test_equal_tasks_are_one_key():
    assert hash(planned([0.3, 1], GRID, SIZE)) == hash(planned(torch.tensor([0.3, 1], dtype=torch.float64), GRID, SIZE))


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(InputError, match="interpolation must be one of"):
        planned([0.3], GRID, SIZE, "magic")
    with pytest.raises(InputError, match="border must be one of"):
        planned([0.3], GRID, SIZE, border="mirror")
