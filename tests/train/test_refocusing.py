import copy
import functools

import pytest
import torch
from torchmetrics.image import PeakSignalNoiseRatio

from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim
from lfref.geometry import planes_at_alphas
from lfref.losses.composite import CompositeLoss
from lfref.metrics.stack import Explained
from lfref.nets.refnet import RefNet
from lfref.refocuser.load import load
from lfref.train.callbacks import Initialization
from lfref.train.modules import Refocusing, WarmupCosine
from tests.train.conftest import batches_of


@pytest.mark.filterwarnings("ignore:.*does not have many workers.*")
@pytest.mark.filterwarnings("ignore:.*number of training batches.*")
class TestFit:
    def test_training_reduces_the_loss_on_held_out_patches(self, module, data, trainer):
        # Without gains at the frame's edge the first epoch leaves more to learn.
        module.net = RefNet(n_planes=3, grid=(3, 3), widths=(8, 8), stem_width=8, padding="zeros")
        module.end_rate, reached = 0.04, []
        for epochs in (1, 12):
            fit = trainer(max_epochs=epochs, callbacks=[Initialization()])
            fit.fit(copy.deepcopy(module), datamodule=data)
            reached.append(fit.callback_metrics)
        assert reached[1]["val/loss"] < reached[0]["val/loss"]
        assert reached[1]["val/explained"] > reached[0]["val/explained"] + 0.5

    def test_the_first_and_last_layers_move_by_their_share_of_a_step(self, module, data, trainer):
        module.optimizer = functools.partial(torch.optim.SGD, lr=0.01)
        steps, before = {}, {name: value.clone() for name, value in module.net.named_parameters()}
        ends = {id(end) for end in module.net.ends()}
        ends = {name for name, value in module.net.named_parameters() if id(value) in ends}
        for rate in (1.0, 0.25):
            twin = copy.deepcopy(module)
            twin.end_rate = rate
            fit = trainer(max_steps=1, limit_val_batches=0)
            fit.fit(twin, datamodule=data)
            steps[rate] = {name: value.detach() - before[name] for name, value in twin.net.named_parameters()}
        assert [group["lr"] for group in fit.optimizers[0].param_groups] == [0.01, 0.0025]
        for name, step in steps[0.25].items():
            share = 0.25 if name in ends else 1.0
            torch.testing.assert_close(step, share * steps[1.0][name], atol=1e-6, rtol=1e-4, msg=name)

    def test_logged_values_are_the_means_over_planes_and_patches_and_terms_add_up(self, module, data, trainer):
        module.metrics["other_psnr"] = PeakSignalNoiseRatio(data_range=1.0)
        fit = trainer(max_epochs=1, log_every_n_steps=1)
        fit.fit(module, datamodule=data)
        for stage in ("train", "val"):
            terms = {name: fit.callback_metrics[f"{stage}/{name}"] for name in module.loss.weights}
            total = sum(weight * terms[name] for name, weight in module.loss.weights.items())
            torch.testing.assert_close(fit.callback_metrics[f"{stage}/loss"], total, atol=1e-4, rtol=1e-5)
        batches = batches_of(data, data.val_dataloader())
        with torch.no_grad():
            pairs = [(module.net(batch["views"], batch["slopes"]), batch["labels"]) for batch in batches]
        for name, quality in (("mpsnr", psnr), ("mssim", ssim)):
            expected = torch.cat([quality(stack, labels) for stack, labels in pairs]).double().mean()
            assert fit.callback_metrics[f"val/{name}"].item() == pytest.approx(expected.item(), abs=1e-4)
        shares = Explained(module.planes.values), Explained(module.planes.values, "near")
        for (stack, labels), batch in zip(pairs, batches, strict=True):
            for share in shares:
                share.update(stack, labels, batch["views"].mean((1, 2)))
        for name, share in zip(("explained", "explained_near"), shares, strict=True):
            assert fit.callback_metrics[f"val/{name}"].item() == pytest.approx(share.compute().item(), rel=1e-5)
        assert "val/explained_wide" not in fit.callback_metrics  # no plane is that far from focus
        squares = torch.cat([(stack.clamp(0, 1) - labels).square().flatten() for stack, labels in pairs])
        expected = -10 * squares.mean().log10().item()
        assert fit.callback_metrics["val/other_psnr"].item() == pytest.approx(expected, abs=1e-3)
        by_plane = torch.cat([psnr(stack, labels) for stack, labels in pairs]).mean(0)
        logged = [fit.callback_metrics[f"val/mpsnr_plane/alpha_{alpha}"] for alpha in ("0.5", "1", "2")]
        torch.testing.assert_close(torch.stack(logged), by_plane.double(), atol=1e-4, rtol=0)

    def test_a_checkpoint_of_a_run_loads_as_a_refocuser(self, module, data, trainer, tmp_path):
        fit = trainer(max_epochs=1)
        fit.fit(module, datamodule=data)
        fit.save_checkpoint(tmp_path / "run.ckpt")
        refocuser = load(tmp_path / "run.ckpt")
        views = torch.rand(3, 3, 3, 20, 22)
        assert refocuser.planes.alphas == (0.5, 1.0, 2.0)
        assert torch.equal(refocuser(views), module.net.eval()(views))


def test_a_warm_up_is_a_line_and_then_a_cosine_for_each_group_at_its_own_rate():
    groups = [{"params": [torch.nn.Parameter(torch.zeros(()))], "lr": rate} for rate in (1.0, 0.04)]
    optimizer, rates = torch.optim.SGD(groups), []
    schedule = WarmupCosine(optimizer, total_steps=12, warmup=0.25)
    for _ in range(14):
        rates.append([group["lr"] for group in optimizer.param_groups])
        optimizer.step()
        schedule.step()
    # Three steps of warm-up, then nine of the cosine: after a third of them, cos(60 degrees) = .5.
    by_hand = {0: 0.25, 1: 0.5, 2: 0.75, 3: 1.0, 6: 0.75, 9: 0.25, 12: 0.0, 13: 0.0}
    assert {step: rates[step][0] for step in by_hand} == pytest.approx(by_hand)
    assert [rate for _, rate in rates] == pytest.approx([0.04 * rate for rate, _ in rates])


def test_another_number_of_planes_than_the_labels_is_refused(module):
    with pytest.raises(InputError, match=r"net\.n_planes=2"):
        Refocusing(module.net, CompositeLoss(), planes_at_alphas((1.0, 2.0)), torch.optim.Adam)
