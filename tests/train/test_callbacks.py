import OpenImageIO
import pytest
import torch

from lfref.errors import InputError
from lfref.train.callbacks import HeadInitialization, RankAgreement, StackPictures, nearest, side_by_side

quiet = pytest.mark.filterwarnings(
    "ignore:.*does not have many workers.*", "ignore:.*number of training batches.*", "ignore:.*Checkpoint directory.*"
)


@quiet
def test_the_head_starts_at_the_label_mean_of_the_first_batch(module, data, trainer):
    module.optimizer = lambda parameters: torch.optim.SGD(parameters, lr=0.0)
    data.setup("fit")
    batch = next(iter(data.train_dataloader()))
    trainer(max_steps=1, limit_val_batches=0, callbacks=[HeadInitialization()]).fit(module, datamodule=data)
    raw = module.net.head(module.net.features(batch["views"]))
    torch.testing.assert_close(raw.mean((0, 2, 3)), batch["labels"].flatten(1, 2).mean((0, 2, 3)), atol=1e-4, rtol=0)


@quiet
def test_a_resumed_run_keeps_its_head(module, data, trainer, tmp_path):
    fit = trainer(max_epochs=1)
    fit.fit(module, datamodule=data)
    fit.save_checkpoint(tmp_path / "run.ckpt")
    trained = module.net.head.weight.detach().clone()
    module.optimizer = lambda parameters: torch.optim.Adam(parameters, lr=0.0)
    state = torch.load(tmp_path / "run.ckpt", weights_only=True)
    state["optimizer_states"][0]["param_groups"][0]["lr"] = 0.0
    torch.save(state, tmp_path / "run.ckpt")
    again = trainer(max_epochs=2, callbacks=[HeadInitialization()])
    again.fit(module, datamodule=data, ckpt_path=tmp_path / "run.ckpt", weights_only=True)
    assert torch.equal(module.net.head.weight, trained)


@quiet
def test_pictures_show_labels_above_predictions(module, data, trainer, tmp_path):
    fit = trainer(max_epochs=2, callbacks=[StackPictures(str(tmp_path / "pictures"), slopes=(-1.5, 0.5))])
    fit.fit(module, datamodule=data)
    files = sorted((tmp_path / "pictures").iterdir())
    assert [file.name for file in files] == ["epoch_0000.png", "epoch_0001.png"]
    batch = next(iter(data.val_dataloader()))
    with torch.no_grad():
        stack = module.net(batch["views"])
    expected = side_by_side(batch["labels"][0, [0, 2]], stack[0, [0, 2]]).permute(1, 2, 0).numpy()
    pixels = OpenImageIO.ImageBuf(str(files[-1])).get_pixels("float")
    assert abs(pixels - expected).max() <= 0.5 / 255 + 1e-6


def test_side_by_side_places_planes_and_rows():
    labels, stack = torch.full((2, 1, 2, 3), 0.25), torch.full((2, 1, 2, 3), float("nan"))
    labels[1] = 2.0
    picture = side_by_side(labels, stack)
    assert picture.tolist() == [[[0.25] * 3 + [1.0] * 3] * 2 + [[0.0] * 6] * 2]


def test_nearest_takes_the_closest_slope():
    assert [nearest((0.5, 1.0, 2.0), alpha) for alpha in (0.1, 0.8, 9.0)] == [0, 1, 2]


@quiet
def test_ranks_with_another_configuration_are_refused(module, data, trainer):
    fit = trainer(fast_dev_run=True, callbacks=[RankAgreement("mine")])
    fit.strategy.broadcast = lambda value, src=0: "another"
    with pytest.raises(InputError, match="same configuration"):
        fit.fit(module, datamodule=data)
