import torch

from lfref.refocus import batches
from lfref.refocus.shift import shift_plan


def planned(slopes):
    return shift_plan.plan(batches.checked_slopes(slopes, (3, 5), (20, 24), None), (3, 5), (20, 24))


def test_equal_plans_are_one_key_so_that_tables_are_kept():
    plans = planned([0.3, 1]), planned(torch.tensor([0.3, 1], dtype=torch.float64))
    assert plans[0] == plans[1]
    assert hash(plans[0]) == hash(plans[1])
